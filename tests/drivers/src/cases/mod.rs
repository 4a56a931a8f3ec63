//! The test cases, in the order they run.

mod calib_live;
mod daemon_faults;
mod daemon_processes;
mod daemon_rig;
mod daemon_support;
mod daemon_truth;
mod daemon_webcams;
mod steering;
mod streaming;
mod support;
mod v4l2_support;
mod v4l2_vivid;
mod v4l2_webcam;
mod vivid_faults;
mod webcam_faults;

use crate::Case;

/// All cases.
pub(crate) fn all() -> Vec<Case> {
    macro_rules! cases {
        ($($module:ident: $($name:ident),+;)+) => {
            vec![$($(Case { name: concat!(stringify!($module), "::", stringify!($name)), run: $module::$name }),+),+]
        };
    }
    cases! {
        streaming: vivid_streams, two_webcams_stream_yuyv, two_webcams_stream_mjpeg;
        steering: controls_act_after_their_latency, light_changes_the_pixels, a_film_is_played,
            the_automatics_work_behind_our_back;
        webcam_faults: damaged_frames_are_gaps, damaged_frames_are_flagged_with_nodrop, a_truncated_jpeg_comes_through,
            frames_lost_in_the_sensor_leave_no_gap, a_failed_transfer_needs_a_restart, a_hang_is_silence,
            stalled_controls_have_their_error, a_slow_webcam_is_seen_by_its_stamps, unplug_and_replug;
        vivid_faults: dropped_buffers_are_gaps, a_flagged_frame_is_one, refused_calls_are_refused_once,
            a_fatal_error_ends_with_the_stream, sequence_numbers_wrap, a_disconnected_device_keeps_its_node;
        v4l2_webcam: formats, controls, stalled_controls, automatics, dropped_errors, delivered_errors, transfer_error, hang, cut_jpeg, unplug, addresses;
        v4l2_vivid: formats, refusals, overrun, controls, control_list, dropped, flag_error, fatal, refused_calls, wrap_sequence, starts_and_stops, disconnect, ten_thousand_frames;
        calib_live: pictures_come, interrupt_ends_the_collection, unplugged_is_an_error;
        daemon_webcams: two_webcams_are_kept_in_step, a_recording_is_the_scene;
        daemon_faults: unplug_and_replug_while_streaming, error_frames_short_frames_urb_errors_hang, stalled_controls,
            auto_modes_switched_on_behind_our_back, truncated_mjpeg, one_camera_slower_than_the_other;
        daemon_processes: daemon_and_reader_as_processes;
    }
}
