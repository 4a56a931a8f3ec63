//! `export`: an MCAP recording as an image folder.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use mirrorball_capture::recording::FolderWriter;
use mirrorball_capture::recording::mcap::McapPlayer;
use mirrorball_capture::{Next, Pace, Repeat, Source};

use super::{CommandError, read_rig_text};

#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    recording: PathBuf,
    /// Folder to write, which must not exist or be empty.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Rig file, instead of the one in the recording.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
}

/// Writes every frame of a recording as a picture.
pub(crate) fn export(args: &ExportArgs) -> Result<(), CommandError> {
    let mut player = McapPlayer::open(&args.recording, Pace::Max, Repeat::ONCE)?;
    let rig = match &args.rig {
        Some(path) => read_rig_text(path)?,
        None => player.rig().map(str::to_owned).ok_or_else(|| CommandError::NoRig {
            path: args.recording.clone(),
        })?,
    };
    let mut writer = FolderWriter::create(&args.folder, player.cameras(), &rig)?;
    let mut n_bad = 0u64;
    loop {
        let frame = match player.next_frame(Duration::from_secs(1)) {
            Ok(Next::Frame(frame)) => frame,
            Ok(Next::TimedOut) => continue,
            Ok(Next::End) => break,
            Err(error) if error.is_skippable() => {
                n_bad += 1;
                tracing::warn!("{error}");
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        match writer.write(&frame) {
            Ok(()) => {}
            Err(error) if error.is_skippable() => {
                n_bad += 1;
                tracing::warn!("{error}");
            }
            Err(error) => return Err(error.into()),
        }
    }
    let n_frames = writer.finish()?;
    tracing::info!(
        "exported {n_frames} frames to `{}`, left out {n_bad} bad parts",
        args.folder.display()
    );
    Ok(())
}
