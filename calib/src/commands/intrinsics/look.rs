//! Pictures to views of the board; from a camera at work, with a word about each to the person who holds the board.

use mirrorball_calib::{
    board::{Board, BoardDetector, BoardView, FoundBoard},
    intrinsics::{Guide, MIN_VIEWS, Taken, common_size, select},
    response::ResponseCurve,
};

use super::{Args, IntrinsicsCommandError, Views};
use crate::commands::{
    CommandError,
    input::{Picture, Verdict, collect},
};

/// Most views that are solved for; more add nothing that the most different of them do not say.
const MAX_VIEWS: usize = 150;

/// Looks for the board in every picture. A camera at work is looked at until the views suffice for a calibration; of a folder
/// or a recording every view counts, as somebody has chosen the pictures.
pub(super) fn look(args: &Args, board: &Board, response: &ResponseCurve) -> Result<Views, CommandError> {
    let mut detector = BoardDetector::new(board);
    let mut gathered = Gathered::default();
    collect::<CommandError>(&args.input, |picture| {
        // The pictures of a folder, and those of a camera at work, are all of the camera that is calibrated.
        let is_other = picture.camera.as_ref().is_some_and(|of| *of != args.camera);
        if is_other && args.input.device.is_none() {
            return Ok(Verdict::Skipped("of another camera".to_owned()));
        }
        let size_px = [picture.rgb.width(), picture.rgb.height()];
        if args.input.device.is_some() && gathered.guide.is_none() {
            gathered.guide = Some(Guide::new(board, size_px, args.model));
        }
        Ok(gathered.look(picture, &mut detector, response))
    })?;
    Ok(gathered.views(&args.camera)?)
}

/// What the pictures so far have shown.
#[derive(Default)]
struct Gathered {
    /// Who judges the views while a person can still take others.
    guide: Option<Guide>,
    sizes: Vec<(String, [u32; 2])>,
    views: Vec<BoardView>,
    edge_widths_px: Vec<Option<f64>>,
    /// Pictures that are not used: name and reason.
    not_found: Vec<(String, String)>,
    n_alike: usize,
}

impl Gathered {
    fn look(&mut self, picture: &Picture, detector: &mut BoardDetector, response: &ResponseCurve) -> Verdict {
        let (width, height) = picture.rgb.dimensions();
        self.sizes.push((picture.name.clone(), [width, height]));
        let size = [width as usize, height as usize];
        match detector.detect(&picture.name, picture.rgb.as_raw(), size, response) {
            Ok(found) => self.judge(found),
            Err(error) => self.skip(&picture.name, error.reason.to_string()),
        }
    }

    fn skip(&mut self, name: &str, reason: String) -> Verdict {
        self.not_found.push((name.to_owned(), reason.clone()));
        Verdict::Skipped(reason)
    }

    /// Whether a view is used.
    fn judge(&mut self, found: FoundBoard) -> Verdict {
        let edge_width_px = Some(found.edge_width_px);
        let taken = self.guide.as_mut().map(|guide| guide.add(&found.view, edge_width_px));
        match taken {
            Some(Taken::Known) => {
                self.n_alike += 1;
                return Verdict::Skipped(format!("this view is there already; {}", self.advice()));
            }
            Some(Taken::Blurred { edge_width_px }) => {
                let reason = format!("blurred, edges are {edge_width_px:.1} px wide: hold the board still, or focus");
                return self.skip(&found.view.name, reason);
            }
            Some(Taken::NoPose) => {
                let reason = "no pose of the board explains it: is it the board of `--board`, and flat?";
                return self.skip(&found.view.name, reason.to_owned());
            }
            Some(Taken::New) | None => {}
        }
        self.views.push(found.view);
        self.edge_widths_px.push(edge_width_px);
        if self.guide.as_ref().is_some_and(|guide| guide.advice().next.is_empty()) {
            Verdict::Enough
        } else {
            Verdict::Used(self.advice())
        }
    }

    /// How many views there are, how much of the picture they cover, and what to do next.
    fn advice(&self) -> String {
        let Some(advice) = self.guide.as_ref().map(Guide::advice) else {
            return format!("{} views", self.views.len());
        };
        let covered = advice.corners.iter().filter(|&&corners| corners > 0).count();
        let percent = 100.0 * covered as f64 / advice.corners.len() as f64;
        let next = advice.next.first().map_or("enough", String::as_str);
        format!("{} views cover {percent:.0} %: {next}", advice.views)
    }

    /// The views to solve for, if they suffice.
    fn views(self, camera: &str) -> Result<Views, IntrinsicsCommandError> {
        if self.sizes.is_empty() {
            return Err(IntrinsicsCommandError::NoPicture {
                camera: camera.to_owned(),
            });
        }
        let size_px = common_size(&self.sizes).map_err(IntrinsicsCommandError::Calibrate)?;
        if self.views.len() < MIN_VIEWS {
            let example = self.not_found.first();
            return Err(IntrinsicsCommandError::NoBoard {
                found: self.views.len(),
                pictures: self.sizes.len(),
                needed: MIN_VIEWS,
                example: example.map_or_else(String::new, |(name, reason)| format!("; `{name}`: {reason}")),
            });
        }
        let mut chosen: Vec<usize> = (0..self.views.len()).collect();
        let mut not_found = self.not_found;
        if chosen.len() > MAX_VIEWS {
            chosen = select(&self.views, size_px, MAX_VIEWS);
            let reason = format!("the `{}` views that are solved for say what it says", chosen.len());
            let left_out = (0..self.views.len()).filter(|index| !chosen.contains(index));
            not_found.extend(left_out.map(|index| (self.views[index].name.clone(), reason.clone())));
        }
        Ok(Views {
            size_px,
            n_alike: self.n_alike,
            views: chosen.iter().map(|&index| self.views[index].clone()).collect(),
            edge_widths_px: chosen.iter().map(|&index| self.edge_widths_px[index]).collect(),
            not_found,
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec2, DVec3};
    use mirrorball_calib::{
        board::SeenCorner,
        camera::{Intrinsics, LensModel, Model},
    };

    use super::*;

    const BOARD: Board = Board::Chessboard {
        columns: 8,
        rows: 6,
        square_m: 0.03,
    };

    /// The board as a camera sees it that stands straight before it, its printed side turned by two angles in radians.
    fn found(name: &str, [right, up]: [f64; 2], middle: DVec3, edge_width_px: f64) -> FoundBoard {
        let lens = Intrinsics {
            size_px: [640, 480],
            focal_px: DVec2::splat(640.0),
            principal_point_px: DVec2::new(319.5, 239.5),
            lens: LensModel::BrownConrady {
                k1: 0.0,
                k2: 0.0,
                p1: 0.0,
                p2: 0.0,
                k3: 0.0,
            },
        };
        let points = BOARD.corners_m();
        let centre = points.iter().sum::<DVec3>() / points.len() as f64;
        let turn = DMat3::from_rotation_y(right) * DMat3::from_rotation_x(up);
        let rotation = turn * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let seen = points.iter().zip(0..).filter_map(|(point, corner)| {
            let pixel = lens.project(middle + rotation * (*point - centre))?;
            lens.contains(pixel).then_some(SeenCorner {
                corner,
                pixel,
                sigma_px: 0.1,
            })
        });
        FoundBoard {
            view: BoardView {
                name: name.to_owned(),
                corners: seen.collect(),
            },
            edge_width_px,
        }
    }

    fn live() -> Gathered {
        Gathered {
            guide: Some(Guide::new(&BOARD, [640, 480], Model::BrownConrady)),
            ..Gathered::default()
        }
    }

    #[test]
    fn a_person_is_told_what_is_wrong_with_a_view_and_what_is_missing() {
        let mut gathered = live();
        let straight = |name, width| found(name, [0.0; 2], DVec3::Z * 0.5, width);
        let Verdict::Used(advice) = gathered.judge(straight("first", 0.5)) else {
            panic!("a first view is new")
        };
        assert!(
            advice.starts_with("1 views cover ") && advice.contains("faces to the left"),
            "{advice}"
        );
        let Verdict::Skipped(advice) = gathered.judge(straight("again", 0.5)) else {
            panic!("nothing has moved")
        };
        assert!(
            advice.contains("there already") && advice.contains("faces to the left"),
            "{advice}"
        );
        let Verdict::Skipped(advice) = gathered.judge(straight("shaken", 4.2)) else {
            panic!("it is blurred")
        };
        assert!(advice.contains("4.2 px"), "{advice}");
        assert_eq!((gathered.views.len(), gathered.n_alike), (1, 1));
        assert_eq!(gathered.not_found[0].0, "shaken");
    }

    #[test]
    fn a_camera_is_watched_until_its_picture_is_covered_from_all_sides() {
        let mut gathered = live();
        let mut verdicts = Vec::new();
        let turns = [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]];
        for place in 0..9 {
            let aside = DVec2::new(f64::from(place % 3 - 1), f64::from(place / 3 - 1)) * DVec2::new(0.14, 0.1);
            for (turn, index) in turns.into_iter().zip(0..) {
                let name = format!("{place} {index}");
                verdicts.push(gathered.judge(found(&name, turn, aside.extend(0.5), 0.5)));
            }
        }
        let enough = verdicts.iter().position(|verdict| *verdict == Verdict::Enough);
        let enough = enough.expect("45 views all over the picture are enough");
        // Not before the last row of places, as the lower part of the picture is empty until then.
        assert!(enough >= 30, "enough after {enough}");
        assert!(verdicts[..enough].iter().all(|verdict| *verdict != Verdict::Enough));
    }

    #[test]
    fn of_chosen_pictures_every_view_counts() {
        let mut gathered = Gathered::default();
        for name in ["first", "again"] {
            let verdict = gathered.judge(found(name, [0.0; 2], DVec3::Z * 0.5, 4.2));
            assert!(matches!(verdict, Verdict::Used(_)), "{verdict:?}");
        }
        assert_eq!(gathered.views.len(), 2);
    }
}
