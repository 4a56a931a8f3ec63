//! The test cases, in the order they run.

mod streaming;

use crate::Case;

/// All cases.
pub(crate) fn all() -> Vec<Case> {
    vec![
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
    ]
}
