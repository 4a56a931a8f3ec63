//! Pictures looked at one by one, with a word about each to the person before the camera.

use super::{InputArgs, InputError, Picture};

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

/// Shows a routine every picture of the input until there are no more, or, from a camera, until it has enough. There a
/// person is told on the terminal what has become of the picture, and used pictures are kept where `--keep` says.
pub(crate) fn collect<E: From<InputError>>(
    input: &InputArgs,
    mut look: impl FnMut(&Picture) -> Result<Verdict, E>,
) -> Result<(), E> {
    let mut pictures = input.open()?;
    while let Some(picture) = pictures.next() {
        let picture = picture?;
        let verdict = look(&picture)?;
        if !matches!(verdict, Verdict::Skipped(_)) {
            pictures.keep(&picture)?;
        }
        if !pictures.is_live() {
            continue;
        }
        match &verdict {
            Verdict::Used(advice) | Verdict::Skipped(advice) => pictures.progress.say(advice),
            Verdict::Enough => break,
        }
    }
    Ok(())
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
        collect::<InputError>(&input, |picture| {
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
