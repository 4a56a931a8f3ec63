//! A rig file being written: what a routine has measured is put in, everything else stays as it is, comments too.

use std::{f64::consts::PI, path::Path};

use glam::DMat3;
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, Value, value};

use super::{Ball, Marker, RigError, RigParts, Role};
use crate::{
    camera::{Intrinsics, LensModel},
    photometry::Photometry,
    pose::Pose,
    response::ResponseCurve,
};

/// Head of a rig file that did not exist before.
const HEAD: &str = "# The rig as calibrated. `configs/README.md` explains every key. Metres; world = frame of the main marker.\nversion = 1\n";

/// The text of a rig file and what it says; both change together.
#[derive(Debug, Clone)]
pub struct RigDraft {
    document: DocumentMut,
}

impl Default for RigDraft {
    fn default() -> Self {
        Self::new()
    }
}

impl RigDraft {
    /// A rig file that says nothing yet.
    #[must_use]
    pub fn new() -> Self {
        let document = HEAD.parse().expect("a constant that is TOML");
        Self { document }
    }

    /// The text of a rig file, whole or in parts. `file` is its name, for error messages only.
    ///
    /// # Errors
    /// As [`RigParts::from_toml`].
    pub fn from_toml(text: &str, file: &Path) -> Result<Self, RigError> {
        RigParts::from_toml(text, file)?;
        let document = text.parse::<DocumentMut>().map_err(|error| RigError::Syntax {
            place: super::Place {
                file: file.to_owned(),
                line: 1,
            },
            message: error.message().to_owned(),
        })?;
        Ok(Self { document })
    }

    /// The text.
    #[must_use]
    pub fn to_toml(&self) -> String {
        self.document.to_string()
    }

    /// What the text says. `file` is its name, for error messages only.
    ///
    /// # Errors
    /// When something was set that a rig may not have, such as a second camera of a name.
    pub fn parts(&self, file: &Path) -> Result<RigParts, RigError> {
        RigParts::from_toml(&self.to_toml(), file)
    }

    /// Says what a camera is for and how large its pictures are; a camera that is not there is added.
    pub fn set_camera(&mut self, name: &str, role: Role, size_px: [u32; 2]) {
        let camera = self.camera(name);
        camera["role"] = value(role.name());
        camera["size_px"] = value(size_px.into_iter().map(i64::from).collect::<Array>());
    }

    /// Writes a camera's lens. The camera must have been set; its size is not touched.
    pub fn set_lens(&mut self, name: &str, intrinsics: &Intrinsics) {
        let lens = table(self.camera(name), "lens");
        lens["model"] = value(intrinsics.lens.model().name());
        lens["focal_px"] = numbers(intrinsics.focal_px.to_array());
        lens["principal_point_px"] = numbers(intrinsics.principal_point_px.to_array());
        lens["distortion"] = numbers(intrinsics.lens.coefficients());
        match intrinsics.lens {
            LensModel::KannalaBrandt { max_angle_rad, .. } | LensModel::Equisolid { max_angle_rad } => {
                lens["max_angle_deg"] = value(max_angle_rad.to_degrees());
            }
            // π is the default of these.
            LensModel::Eucm { max_angle_rad, .. } | LensModel::DoubleSphere { max_angle_rad, .. }
                if max_angle_rad < PI =>
            {
                lens["max_angle_deg"] = value(max_angle_rad.to_degrees());
            }
            LensModel::BrownConrady { .. }
            | LensModel::Rational { .. }
            | LensModel::Eucm { .. }
            | LensModel::DoubleSphere { .. } => {
                lens.remove("max_angle_deg");
            }
        }
    }

    /// Writes all of a camera's photometry but its colour matrix.
    pub fn set_photometry(&mut self, name: &str, photometry: &Photometry) {
        let entry = table(self.camera(name), "photometry");
        entry["sensitivity"] = value(photometry.sensitivity);
        entry["vignetting"] = numbers(photometry.vignetting);
        entry["full_well_e"] = value(photometry.full_well_e);
        entry["read_noise_e"] = value(photometry.read_noise_e);
        entry["response"] = if photometry.response == ResponseCurve::srgb() {
            value("srgb")
        } else {
            numbers((0..=255).map(|code| photometry.response.linear_from_code(code)))
        };
    }

    /// Writes a camera's colour matrix: its linear RGB to the rig's common linear RGB. The camera must have a
    /// `[camera.photometry]`.
    pub fn set_color(&mut self, name: &str, color: &DMat3) {
        let rows = (0..3).map(|row| color.row(row).to_array());
        table(self.camera(name), "photometry")["color"] = matrix(rows);
    }

    /// Writes where a fixed camera stands.
    pub fn set_camera_from_world(&mut self, name: &str, camera_from_world: &Pose) {
        self.camera(name)["camera_from_world"] = pose(camera_from_world);
    }

    /// Says which marker defines the world.
    pub fn set_main_marker(&mut self, id: u32) {
        self.document["main_marker"] = value(i64::from(id));
    }

    /// Writes a marker; one with its id is replaced.
    pub fn set_marker(&mut self, marker: &Marker) {
        let entry = entry(&mut self.document, "marker", |table| {
            table.get("id").and_then(Item::as_integer) == Some(i64::from(marker.id))
        });
        entry["family"] = value(marker.family.name());
        entry["id"] = value(i64::from(marker.id));
        entry["side_m"] = value(marker.side_m);
        entry["white_reflectance"] = value(marker.white_reflectance);
        entry["world_from_marker"] = pose(&marker.world_from_marker);
    }

    /// Writes the mirror ball.
    pub fn set_ball(&mut self, ball: &Ball) {
        let entry = table(self.document.as_table_mut(), "ball");
        entry["center_m"] = numbers(ball.center_m.to_array());
        entry["radius_m"] = value(ball.radius_m);
        entry["reflectance"] = numbers(ball.reflectance);
        entry["roughness"] = value(ball.roughness);
    }

    /// The entry of the camera with this name, added when it is not there.
    fn camera(&mut self, name: &str) -> &mut Table {
        let camera = entry(&mut self.document, "camera", |table| {
            table.get("name").and_then(Item::as_str) == Some(name)
        });
        camera["name"] = value(name);
        camera
    }
}

/// The entry of a list of tables for which `is_it` holds, added when there is none.
fn entry<'a>(document: &'a mut DocumentMut, list: &str, is_it: impl Fn(&Table) -> bool) -> &'a mut Table {
    let list = document
        .entry(list)
        .or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()))
        .as_array_of_tables_mut()
        .expect("checked when read: a list of tables");
    let found = list.iter().position(is_it);
    if found.is_none() {
        list.push(Table::new());
    }
    list.get_mut(found.unwrap_or(list.len() - 1))
        .expect("found or just added")
}

/// A table inside a table, added when it is not there.
fn table<'a>(parent: &'a mut Table, key: &str) -> &'a mut Table {
    parent
        .entry(key)
        .or_insert_with(|| Item::Table(Table::new()))
        .as_table_mut()
        .expect("checked when read: a table")
}

fn numbers(values: impl IntoIterator<Item = f64>) -> Item {
    value(values.into_iter().collect::<Array>())
}

/// Rows of numbers, a line each.
fn matrix<const N: usize>(rows: impl IntoIterator<Item = [f64; N]>) -> Item {
    let mut list = Array::new();
    for row in rows {
        let mut row = Value::Array(row.into_iter().collect());
        row.decor_mut().set_prefix("\n  ");
        list.push_formatted(row);
    }
    list.set_trailing("\n");
    list.set_trailing_comma(true);
    value(list)
}

fn pose(pose: &Pose) -> Item {
    let [first, second, third, _] = pose.to_rows4();
    matrix([first, second, third])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Rig;

    const RIG: &str = include_str!("../../tests/support/rig.toml");

    /// Everything of a rig set anew.
    fn copy(rig: &Rig, draft: &mut RigDraft) {
        draft.set_main_marker(rig.main_marker);
        for camera in &rig.cameras {
            draft.set_camera(&camera.name, camera.role, camera.intrinsics.size_px);
            draft.set_lens(&camera.name, &camera.intrinsics);
            draft.set_photometry(&camera.name, &camera.photometry);
            draft.set_color(&camera.name, &camera.photometry.color);
            if let Some(camera_from_world) = &camera.camera_from_world {
                draft.set_camera_from_world(&camera.name, camera_from_world);
            }
        }
        for marker in &rig.markers {
            draft.set_marker(marker);
        }
        if let Some(ball) = &rig.ball {
            draft.set_ball(ball);
        }
    }

    #[test]
    fn a_rig_that_is_written_is_read_back() {
        let file = Path::new("rig.toml");
        let rig = Rig::from_toml(RIG, file).unwrap();
        let mut draft = RigDraft::new();
        copy(&rig, &mut draft);
        let text = draft.to_toml();
        let back = Rig::from_toml(&text, file).unwrap_or_else(|error| panic!("{error}\n{text}"));
        for (camera, written) in rig.cameras.iter().zip(&back.cameras) {
            assert_eq!(camera.name, written.name);
            assert_eq!(camera.photometry, written.photometry);
            assert_eq!(camera.intrinsics.parameters(), written.intrinsics.parameters());
        }
        assert_eq!(rig.ball, back.ball);
        assert_eq!(rig.markers.len(), back.markers.len());
    }

    #[test]
    fn what_is_not_set_stays_with_its_comments() {
        let file = Path::new("rig.toml");
        let rig = Rig::from_toml(RIG, file).unwrap();
        let mut draft = RigDraft::from_toml(RIG, file).unwrap();
        let mut ball = rig.ball.unwrap();
        ball.radius_m = 0.0417;
        draft.set_ball(&ball);
        let text = draft.to_toml();
        let changed: Vec<(&str, &str)> = RIG.lines().zip(text.lines()).filter(|(a, b)| a != b).collect();
        assert_eq!(RIG.lines().count(), text.lines().count());
        assert!(changed.len() <= 4, "{changed:?}");
        assert_eq!(draft.parts(file).unwrap().ball, Some(ball));
    }

    #[test]
    fn parts_may_be_missing() {
        let file = Path::new("rig.toml");
        let mut draft = RigDraft::new();
        draft.set_camera("left", Role::Scene, [640, 480]);
        let parts = draft.parts(file).unwrap();
        assert_eq!(parts.camera("left").map(|camera| camera.size_px), Some([640, 480]));
        assert_eq!(parts.camera("left").unwrap().intrinsics, None);
        let error = Rig::from_toml(&draft.to_toml(), file).unwrap_err().to_string();
        assert!(error.contains("mirrorball-calib intrinsics"), "{error}");
        let error = RigDraft::from_toml("version = 2\n", file).unwrap_err().to_string();
        assert_eq!(
            error,
            "`rig.toml`, line 1: `version` is `2`, from a newer program (this one knows up to `1`)"
        );
        let error = RigDraft::from_toml("version = 99999999999999999999\n", file).unwrap_err();
        assert!(matches!(error, RigError::Newer { .. }), "{error}");
    }
}
