//! `import`: an image folder as an MCAP recording.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use mirrorball_capture::recording::mcap::{ChunkCompression, Recorded, Recorder, RecorderOptions};
use mirrorball_capture::{Next, Pace, Player, Repeat, Source};

use super::{CommandError, read_rig_text};

#[derive(Debug, Args)]
pub(crate) struct ImportArgs {
    /// Folder with `rig.toml`, `frames.csv` and the pictures.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// File to write, which must not exist.
    #[arg(value_name = "FILE.mcap")]
    recording: PathBuf,
    /// Compress with LZ4.
    #[arg(long)]
    lz4: bool,
}

/// Writes every picture of a folder, decoded, into one file.
pub(crate) fn import(args: &ImportArgs) -> Result<(), CommandError> {
    let mut player = Player::open(&args.folder, Pace::Max, Repeat::ONCE)?;
    let options = RecorderOptions {
        rig: Some(read_rig_text(&args.folder.join("rig.toml"))?),
        compression: if args.lz4 {
            ChunkCompression::Lz4
        } else {
            ChunkCompression::None
        },
        ..RecorderOptions::default()
    };
    let mut recorder = Recorder::create(&args.recording, player.cameras(), options)?;
    let mut n_bad = 0u64;
    loop {
        match player.next_frame(Duration::from_secs(1)) {
            Ok(Next::Frame(frame)) => {
                if recorder.record_or_wait(frame) == Recorded::Stopped {
                    break;
                }
            }
            Ok(Next::TimedOut) => {}
            Ok(Next::End) => break,
            Err(error) if error.is_skippable() => {
                n_bad += 1;
                tracing::warn!("{error}");
            }
            Err(error) => return Err(error.into()),
        }
    }
    let stats = recorder.finish()?;
    tracing::info!(
        "imported {} frames into `{}` ({:.1} MB), left out {n_bad} bad pictures",
        stats.frames,
        args.recording.display(),
        stats.bytes as f64 / 1e6
    );
    Ok(())
}
