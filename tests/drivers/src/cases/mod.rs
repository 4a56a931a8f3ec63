//! The test cases, in the order they run.

mod streaming;
mod v4l2_support;
mod v4l2_vivid;
mod v4l2_webcam;

use crate::Case;

/// All cases.
pub(crate) fn all() -> Vec<Case> {
    let mut all = vec![
        Case {
            name: "vivid_streams",
            run: streaming::vivid_streams,
        },
        Case {
            name: "webcams_stream_yuyv",
            run: streaming::webcams_stream_yuyv,
        },
        Case {
            name: "webcams_stream_mjpeg",
            run: streaming::webcams_stream_mjpeg,
        },
    ];
    all.extend(v4l2_webcam::CASES);
    all.extend(v4l2_vivid::CASES);
    all
}
