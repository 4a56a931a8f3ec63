//! What each fault of `vivid` looks like.

use std::io;

use mirrorball_driver_tests::raw_camera::{RawCamera, RawFrame};
use mirrorball_driver_tests::vivid::{self, VividFault};

use super::support::{PATIENCE, SILENCE, YUYV, ensure, errno, say};

fn open() -> Result<RawCamera, String> {
    let node = vivid::nodes().into_iter().next().ok_or("there is no camera of vivid")?;
    let camera = RawCamera::open(&node).map_err(say)?;
    camera.set_format((320, 180), YUYV).map_err(say)?;
    camera.set_rate(60).map_err(say)?;
    Ok(camera)
}

fn frames(camera: &mut RawCamera, n_frames: usize) -> Result<Vec<RawFrame>, String> {
    (0..n_frames)
        .map(|_| {
            camera
                .next_frame(PATIENCE)
                .map_err(say)?
                .ok_or_else(|| "no frame".to_owned())
        })
        .collect()
}

fn set(camera: &RawCamera, fault: VividFault, value: i32) -> Result<(), String> {
    vivid::set(camera, fault, value).map_err(|error| format!("{fault:?}: {error}"))
}

fn is(result: &io::Result<()>, errno: i32) -> bool {
    result.as_ref().err().and_then(io::Error::raw_os_error) == Some(errno)
}

pub(super) fn dropped_buffers_are_gaps() -> Result<(), String> {
    let mut camera = open()?;
    set(&camera, VividFault::DroppedPercent, 30)?;
    camera.start(4).map_err(say)?;
    let received = frames(&mut camera, 60)?;
    let gaps: u32 = received
        .windows(2)
        // Under load vivid may give a number twice.
        .map(|pair| pair[1].sequence.saturating_sub(pair[0].sequence + 1))
        .sum();
    set(&camera, VividFault::DroppedPercent, 100)?;
    while camera.next_frame(SILENCE).map_err(say)?.is_some() {}
    set(&camera, VividFault::DroppedPercent, 0)?;
    ensure(gaps >= 5, || {
        format!("{gaps} gaps in 60 frames, though 30 % are dropped")
    })?;
    frames(&mut camera, 3).map(|_| ())
}

pub(super) fn a_flagged_frame_is_one() -> Result<(), String> {
    let mut camera = open()?;
    camera.start(4).map_err(say)?;
    frames(&mut camera, 3)?;
    set(&camera, VividFault::FlagError, 1)?;
    let damaged = frames(&mut camera, 15)?
        .iter()
        .filter(|frame| frame.is_damaged())
        .count();
    ensure(damaged == 1, || format!("{damaged} damaged frames"))
}

pub(super) fn refused_calls_are_refused_once() -> Result<(), String> {
    for fault in [VividFault::RequestBuffers, VividFault::StreamOn] {
        let mut refusing = open()?;
        set(&refusing, fault, 1)?;
        let first = refusing.start(4);
        // Its buffers would keep others from choosing a format.
        drop(refusing);
        ensure(is(&first, errno::EINVAL), || {
            format!("{fault:?}: EINVAL expected, found {first:?}")
        })?;
        let mut camera = open()?;
        camera.start(4).map_err(say)?;
        frames(&mut camera, 3)?;
    }
    Ok(())
}

pub(super) fn a_fatal_error_ends_with_the_stream() -> Result<(), String> {
    let mut camera = open()?;
    camera.start(4).map_err(say)?;
    frames(&mut camera, 3)?;
    set(&camera, VividFault::Fatal, 1)?;
    let error = loop {
        match camera.next_frame(PATIENCE) {
            Ok(Some(_)) => {}
            Ok(None) => return Err("silence instead of an error".to_owned()),
            Err(error) => break error,
        }
    };
    ensure(error.raw_os_error() == Some(errno::EIO), || {
        format!("EIO expected, found {error}")
    })?;
    camera.stop().map_err(say)?;
    camera.start(4).map_err(say)?;
    frames(&mut camera, 3).map(|_| ())
}

pub(super) fn sequence_numbers_wrap() -> Result<(), String> {
    let mut camera = open()?;
    set(&camera, VividFault::WrapSequence, 1)?;
    camera.start(4).map_err(say)?;
    let first = frames(&mut camera, 1)?[0].sequence;
    let last = frames(&mut camera, 150)?[149].sequence;
    set(&camera, VividFault::WrapSequence, 0)?;
    ensure(first > u32::MAX - 128 && last < 1000, || {
        format!("from {first} to {last}")
    })
}

pub(super) fn a_disconnected_device_keeps_its_node() -> Result<(), String> {
    let mut camera = open()?;
    camera.start(4).map_err(say)?;
    frames(&mut camera, 3)?;
    let nodes = vivid::nodes();
    set(&camera, VividFault::Disconnect, 1)?;
    let error = loop {
        match camera.next_frame(PATIENCE) {
            Ok(Some(_)) => {}
            Ok(None) => return Err("the reader was not told".to_owned()),
            Err(error) => break error,
        }
    };
    let exists = nodes[0].exists();
    drop(camera);
    vivid::reload().map_err(say)?;
    ensure(error.raw_os_error() == Some(errno::ENODEV), || {
        format!("ENODEV expected, found {error}")
    })?;
    ensure(exists, || "the node is gone".to_owned())?;
    let mut camera = open()?;
    camera.start(4).map_err(say)?;
    frames(&mut camera, 3).map(|_| ())
}
