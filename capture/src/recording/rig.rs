//! What a recording needs of its rig file: name, role and size of every camera. All other keys are left to others.

use std::path::Path;

use serde::Deserialize;

use crate::frame::{PixelFormat, Size};
use crate::source::{CAMERAS_MAX, CameraDescription, CameraRole, NAME_MAX_BYTES, SIDE_MAX_PX, SourceError};

#[derive(Deserialize)]
struct RigFile {
    camera: Vec<RigCamera>,
}

#[derive(Deserialize)]
struct RigCamera {
    name: String,
    role: String,
    size_px: [i64; 2],
}

/// Reads the cameras of the rig file at `path`; their format is taken to be [`PixelFormat::Rgb8`], of which a rig file
/// says nothing.
///
/// # Errors
///
/// [`SourceError::ReadFile`], [`SourceError::RigSyntax`], [`SourceError::RigValue`] or [`SourceError::RigLeader`].
pub fn read_cameras(path: &Path) -> Result<Vec<CameraDescription>, SourceError> {
    let text = std::fs::read_to_string(path).map_err(|source| SourceError::ReadFile {
        path: path.to_path_buf(),
        source,
    })?;
    parse_cameras(path, &text)
}

/// The same for the text of a rig file; `path` is for messages.
pub(super) fn parse_cameras(path: &Path, text: &str) -> Result<Vec<CameraDescription>, SourceError> {
    let rig: RigFile = toml::from_str(text).map_err(|source| SourceError::RigSyntax {
        path: path.to_path_buf(),
        source: Box::new(source),
    })?;
    if rig.camera.len() > CAMERAS_MAX {
        let found = rig.camera.len().to_string();
        return Err(bad_value(path, "number of cameras".to_owned(), found, "1..=16"));
    }
    let mut cameras = Vec::with_capacity(rig.camera.len());
    for camera in &rig.camera {
        let camera = check_camera(path, camera)?;
        if cameras
            .iter()
            .any(|other: &CameraDescription| other.name == camera.name)
        {
            return Err(bad_value(
                path,
                "camera `name`".to_owned(),
                camera.name.to_string(),
                "a name used only once",
            ));
        }
        cameras.push(camera);
    }
    let n_leaders = cameras.iter().filter(|camera| camera.role == CameraRole::Scene).count();
    if n_leaders != 1 {
        return Err(SourceError::RigLeader {
            path: path.to_path_buf(),
            n_leaders,
        });
    }
    Ok(cameras)
}

fn check_camera(path: &Path, camera: &RigCamera) -> Result<CameraDescription, SourceError> {
    if camera.name.is_empty() || camera.name.len() > NAME_MAX_BYTES {
        return Err(bad_value(
            path,
            "camera `name`".to_owned(),
            camera.name.clone(),
            "1 to 64 bytes",
        ));
    }
    let role = match camera.role.as_str() {
        "scene" => CameraRole::Scene,
        "ball" => CameraRole::Ball,
        "fisheye" => CameraRole::Fisheye,
        other => {
            let key = format!("`role` of camera `{}`", camera.name);
            return Err(bad_value(path, key, other.to_owned(), "`scene`, `ball` or `fisheye`"));
        }
    };
    let [width, height] = camera.size_px;
    let (Some(width), Some(height)) = (side_px(width), side_px(height)) else {
        let key = format!("`size_px` of camera `{}`", camera.name);
        return Err(bad_value(
            path,
            key,
            format!("[{width}, {height}]"),
            "1..=16384 for each side",
        ));
    };
    Ok(CameraDescription {
        name: camera.name.as_str().into(),
        role,
        size: Size { width, height },
        format: PixelFormat::Rgb8,
    })
}

fn side_px(value: i64) -> Option<u32> {
    u32::try_from(value)
        .ok()
        .filter(|side| (1..=SIDE_MAX_PX).contains(side))
}

fn bad_value(path: &Path, key: String, found: String, allowed: &'static str) -> SourceError {
    SourceError::RigValue {
        path: path.to_path_buf(),
        key,
        found,
        allowed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Vec<CameraDescription>, SourceError> {
        parse_cameras(Path::new("rig.toml"), text)
    }

    fn camera(name: &str, role: &str, size_px: &str) -> String {
        format!("[[camera]]\nname = \"{name}\"\nrole = \"{role}\"\nsize_px = {size_px}\n")
    }

    #[test]
    fn keys_of_others_are_left_alone() {
        let text = format!(
            "version = 1\n{}focal = 3.0\n[[marker]]\nid = 1\n",
            camera("a", "scene", "[640, 480]")
        );
        let cameras = parse(&text).unwrap();
        assert_eq!(cameras.len(), 1);
        assert_eq!(
            cameras[0].size,
            Size {
                width: 640,
                height: 480
            }
        );
    }

    #[test]
    fn several_cameras_may_film_the_light() {
        let text = camera("a", "scene", "[640, 480]")
            + &camera("b", "fisheye", "[640, 640]")
            + &camera("c", "ball", "[320, 240]")
            + &camera("d", "ball", "[320, 240]");
        let roles: Vec<CameraRole> = parse(&text).unwrap().iter().map(|camera| camera.role).collect();
        let expected = [
            CameraRole::Scene,
            CameraRole::Fisheye,
            CameraRole::Ball,
            CameraRole::Ball,
        ];
        assert_eq!(roles, expected);
    }

    #[test]
    fn every_bad_value_is_named() {
        let cases = [
            (camera("", "scene", "[1, 1]"), "`name`"),
            (camera(&"x".repeat(65), "scene", "[1, 1]"), "`name`"),
            (camera("a", "drone", "[1, 1]"), "`role` of camera `a`"),
            (camera("a", "scene", "[0, 1]"), "`size_px` of camera `a`"),
            (camera("a", "scene", "[1, -5]"), "`size_px` of camera `a`"),
            (camera("a", "scene", "[1, 16385]"), "`size_px` of camera `a`"),
            (
                camera("a", "scene", "[1, 1]") + &camera("a", "ball", "[1, 1]"),
                "only once",
            ),
            (
                (0..17).map(|i| camera(&i.to_string(), "ball", "[1, 1]")).collect(),
                "number of cameras",
            ),
        ];
        for (text, expected) in cases {
            let error = parse(&text).unwrap_err();
            assert!(matches!(error, SourceError::RigValue { .. }), "{error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    #[test]
    fn exactly_one_camera_leads() {
        let none = parse(&camera("a", "ball", "[1, 1]")).unwrap_err();
        assert!(matches!(none, SourceError::RigLeader { n_leaders: 0, .. }));
        let two = parse(&(camera("a", "scene", "[1, 1]") + &camera("b", "scene", "[1, 1]"))).unwrap_err();
        assert!(matches!(two, SourceError::RigLeader { n_leaders: 2, .. }));
    }

    #[test]
    fn missing_keys_are_syntax_errors() {
        for text in ["", "version = 1", "[[camera]]\nname = \"a\"\n", "not toml"] {
            assert!(
                matches!(parse(text).unwrap_err(), SourceError::RigSyntax { .. }),
                "{text}"
            );
        }
    }
}
