//! Pictures looked at one by one, with a word about each to the person before the camera.

use super::{InputArgs, InputError, Picture};
use crate::commands::progress::Progress;

/// What a routine makes of a picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It is used; what a person should do next.
    Used(String),
    /// It is not used; why, or what a person should do.
    Skipped(String),
    /// It is used, and no more are needed.
    Enough,
}

/// How many pictures there were.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Collected {
    /// Pictures looked at.
    pub(crate) seen: usize,
    /// Pictures used.
    pub(crate) used: usize,
}

/// Shows a routine every picture of the input until there are no more, or, from a camera, until it has enough. Advice stands
/// beside the progress bar on a terminal; used pictures are kept where `--keep` says.
pub(crate) fn collect<E: From<InputError>>(
    input: &InputArgs,
    mut look: impl FnMut(&Picture) -> Result<Verdict, E>,
) -> Result<Collected, E> {
    let mut pictures = input.open()?;
    let progress = Progress::pictures(pictures.expected());
    let mut collected = Collected::default();
    while let Some(picture) = pictures.next() {
        let picture = picture?;
        let verdict = look(&picture)?;
        progress.tick(&picture.name);
        collected.seen += 1;
        let (is_used, advice) = match &verdict {
            Verdict::Used(advice) => (true, advice.as_str()),
            Verdict::Skipped(advice) => (false, advice.as_str()),
            Verdict::Enough => (true, "enough"),
        };
        if pictures.is_live() {
            progress.say(advice);
        }
        if is_used {
            collected.used += 1;
            pictures.keep(&picture)?;
        }
        if pictures.is_live() && verdict == Verdict::Enough {
            break;
        }
    }
    Ok(collected)
}

#[cfg(test)]
mod tests {
    use image::RgbImage;

    use super::{
        super::{InputArgs, LiveArgs},
        *,
    };

    fn folder_of(n: u32) -> (tempfile::TempDir, InputArgs) {
        let folder = tempfile::tempdir().unwrap();
        for i in 0..n {
            RgbImage::new(4 + i, 4)
                .save(folder.path().join(format!("{i}.png")))
                .unwrap();
        }
        let live = LiveArgs {
            size: None,
            rate: 30.0,
            frames: None,
            seconds: None,
            keep: None,
        };
        let input = InputArgs {
            images: Some(folder.path().to_owned()),
            recording: None,
            device: None,
            live,
        };
        (folder, input)
    }

    #[test]
    fn every_picture_of_a_folder_is_looked_at() {
        let (_folder, input) = folder_of(5);
        let mut widths = Vec::new();
        let collected = collect::<InputError>(&input, |picture| {
            widths.push(picture.rgb.width());
            // A folder is read to its end, however early there is enough.
            Ok(match picture.rgb.width() {
                4 => Verdict::Enough,
                5 => Verdict::Skipped("blurred".to_owned()),
                _ => Verdict::Used("tilt it to the left".to_owned()),
            })
        })
        .unwrap();
        assert_eq!(widths, [4, 5, 6, 7, 8]);
        assert_eq!(collected, Collected { seen: 5, used: 4 });
    }

    #[test]
    fn the_first_error_ends_it() {
        let (folder, input) = folder_of(3);
        std::fs::write(folder.path().join("1.png"), "no picture").unwrap();
        let mut n = 0;
        let error = collect::<InputError>(&input, |_| {
            n += 1;
            Ok(Verdict::Enough)
        })
        .unwrap_err();
        assert!(matches!(error, InputError::Picture { .. }), "{error:?}");
        assert_eq!(n, 1);
    }
}
