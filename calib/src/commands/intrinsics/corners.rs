//! Files of corners: what was found in pictures, or what somebody else found.

use std::{fs, path::Path};

use glam::DVec2;
use mirrorball_calib::board::{BoardView, SeenCorner};
use serde::{Deserialize, Serialize};

use super::{IntrinsicsCommandError, Views};

/// Standard deviation of a corner where the file says none, in pixels.
const SIGMA_PX: f64 = 0.1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    size_px: [u32; 2],
    views: Vec<View>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct View {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    edge_width_px: Option<f64>,
    corners: Vec<Corner>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Corner {
    corner: u32,
    pixel: [f64; 2],
    #[serde(default = "sigma_px")]
    sigma_px: f64,
}

fn sigma_px() -> f64 {
    SIGMA_PX
}

pub(super) fn read(path: &Path) -> Result<Views, IntrinsicsCommandError> {
    let bytes = fs::read(path).map_err(|source| IntrinsicsCommandError::ReadCorners {
        file: path.to_owned(),
        source,
    })?;
    let file: File = serde_json::from_slice(&bytes).map_err(|source| IntrinsicsCommandError::Corners {
        file: path.to_owned(),
        source,
    })?;
    let edge_widths_px = file.views.iter().map(|view| view.edge_width_px).collect();
    let views = file.views.into_iter().map(|view| BoardView {
        name: view.name,
        corners: view
            .corners
            .iter()
            .map(|corner| SeenCorner {
                corner: corner.corner,
                pixel: DVec2::from_array(corner.pixel),
                sigma_px: corner.sigma_px,
            })
            .collect(),
    });
    Ok(Views {
        size_px: file.size_px,
        views: views.collect(),
        edge_widths_px,
        not_found: Vec::new(),
        n_alike: 0,
    })
}

pub(super) fn write(path: &Path, views: &Views) -> Result<(), IntrinsicsCommandError> {
    let seen = views.views.iter().zip(&views.edge_widths_px);
    let file = File {
        size_px: views.size_px,
        views: seen
            .map(|(view, edge_width_px)| View {
                name: view.name.clone(),
                edge_width_px: *edge_width_px,
                corners: view
                    .corners
                    .iter()
                    .map(|corner| Corner {
                        corner: corner.corner,
                        pixel: corner.pixel.to_array(),
                        sigma_px: corner.sigma_px,
                    })
                    .collect(),
            })
            .collect(),
    };
    let text = serde_json::to_string(&file).expect("numbers and text");
    fs::write(path, text).map_err(|source| IntrinsicsCommandError::WriteCorners {
        file: path.to_owned(),
        source,
    })
}
