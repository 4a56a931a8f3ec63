//! The USB side of a simulated webcam: one thread that answers the kernel's requests and sends frames at their pace.
//!
//! One thread, so that the order of answers is never in doubt: a request that was taken back is not answered after
//! that, and an old stream cannot write into a new one.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::controls::{GET_CUR, GET_DEF, GET_INFO, GET_LEN, GET_MAX, GET_MIN, SET_CUR};
use super::descriptors::{CONTROL_INTERFACE, STREAMING_INTERFACE, descriptor};
use super::faults::FrameFault;
use super::format::{Negotiated, PROBE_BYTES};
use super::frames::Frames;
use super::stream::OutgoingFrame;
use super::{State, WebcamConfig, lock};
use crate::usbip::wire::{self, Direction, PROTOCOL_ERROR, Request, STALL, Submit};

/// How often a thread with nothing to do looks whether a fault was lifted.
const IDLE: Duration = Duration::from_millis(20);
/// Control selector of the request error code (UVC 1.1, table A-9).
const REQUEST_ERROR_CODE: u8 = 2;
/// Control selectors of the streaming interface (table A-15).
const PROBE: u8 = 1;
const COMMIT: u8 = 2;

/// A stream that runs.
struct Streaming {
    agreed: Negotiated,
    due: Instant,
    frame: OutgoingFrame,
    /// Whether `frame` is on its way.
    sending: bool,
    /// Whether the next request fails.
    fail_transfer: bool,
    odd: bool,
}

pub(super) struct Device {
    socket: UnixStream,
    inbox: Vec<u8>,
    outbox: Vec<u8>,
    name: String,
    serial: String,
    state: Arc<Mutex<State>>,
    frames: Frames,
    probed: Negotiated,
    committed: Negotiated,
    /// Isochronous requests that wait for pictures.
    waiting: VecDeque<Submit>,
    /// Requests that were taken back before they came: (their number, the unlink's).
    unlinked_early: Vec<(u32, u32)>,
    last_submit: u32,
    streaming: Option<Streaming>,
    /// Reused from request to request.
    payload: Vec<u8>,
    results: Vec<wire::IsoResult>,
}

impl Device {
    pub(super) fn new(socket: UnixStream, config: &WebcamConfig, state: Arc<Mutex<State>>) -> Self {
        Self {
            socket,
            inbox: Vec::new(),
            outbox: Vec::new(),
            name: config.name.clone(),
            serial: config.serial.clone(),
            frames: Frames::new(config.sensor, config.seed, Arc::clone(&state)),
            state,
            probed: Negotiated::default(),
            committed: Negotiated::default(),
            waiting: VecDeque::new(),
            unlinked_early: Vec::new(),
            last_submit: 0,
            streaming: None,
            payload: Vec::new(),
            results: Vec::new(),
        }
    }

    /// Serves the kernel until the plug is pulled on either side.
    pub(super) fn run(mut self) {
        loop {
            let timeout = self.send_what_is_due();
            if self.flush().is_none() || self.receive(timeout).is_none() || self.flush().is_none() {
                return;
            }
        }
    }

    /// Waits for the kernel, at most `timeout`, and deals with what it says. `None` at the end of the connection.
    fn receive(&mut self, timeout: Duration) -> Option<()> {
        let timeout = Timespec {
            tv_sec: 0,
            tv_nsec: timeout.min(IDLE).as_nanos() as _,
        };
        let mut sockets = [PollFd::new(&self.socket, PollFlags::IN)];
        // An interrupted wait is a short one.
        let _ = poll(&mut sockets, Some(&timeout));
        if sockets[0].revents().is_empty() {
            return Some(());
        }
        let mut chunk = [0; 16_384];
        let received = self.socket.read(&mut chunk).ok().filter(|received| *received > 0)?;
        self.inbox.extend_from_slice(&chunk[..received]);
        let mut used = 0;
        while let Some((request, length)) = wire::parse(&self.inbox[used..]).ok()? {
            used += length;
            match request {
                Request::Submit(submit) => self.submitted(submit),
                Request::Unlink { seqnum, target } => self.unlinked(seqnum, target),
            }
        }
        self.inbox.drain(..used);
        Some(())
    }

    fn flush(&mut self) -> Option<()> {
        self.socket.write_all(&self.outbox).ok()?;
        self.outbox.clear();
        Some(())
    }

    fn submitted(&mut self, submit: Submit) {
        self.last_submit = submit.seqnum;
        if let Some(index) = self
            .unlinked_early
            .iter()
            .position(|(target, _)| *target == submit.seqnum)
        {
            let (_, unlink) = self.unlinked_early.swap_remove(index);
            wire::reply_unlink(&mut self.outbox, unlink, true);
        } else if submit.endpoint == 0 {
            self.control_request(&submit);
        } else {
            self.waiting.push_back(submit);
        }
    }

    /// An unlink can overtake the request that it takes back: the kernel numbers requests in order, so a number
    /// greater than the last one's has not come yet.
    fn unlinked(&mut self, seqnum: u32, target: u32) {
        if target.wrapping_sub(self.last_submit).cast_signed() > 0 {
            self.unlinked_early.push((target, seqnum));
            return;
        }
        let index = self.waiting.iter().position(|submit| submit.seqnum == target);
        if let Some(index) = index {
            self.waiting.remove(index);
        }
        wire::reply_unlink(&mut self.outbox, seqnum, index.is_some());
    }

    fn control_request(&mut self, submit: &Submit) {
        let answer = self.answer(submit.setup, &submit.data);
        match (answer, submit.direction) {
            (None, _) => wire::reply(&mut self.outbox, submit.seqnum, STALL, (0, &[])),
            (Some(_), Direction::Out) => {
                wire::reply(&mut self.outbox, submit.seqnum, 0, (submit.data.len() as u32, &[]));
            }
            (Some(mut bytes), Direction::In) => {
                bytes.truncate(submit.length as usize);
                wire::reply(&mut self.outbox, submit.seqnum, 0, (bytes.len() as u32, &bytes));
            }
        }
    }

    /// The answer to a control request; `None` for a stall (USB 2.0, 9.4; UVC 1.1, 4.2 and 4.3).
    fn answer(&mut self, setup: [u8; 8], data: &[u8]) -> Option<Vec<u8>> {
        let [kind, request, value_low, value_high, index_low, index_high, ..] = setup;
        let value = u16::from_le_bytes([value_low, value_high]);
        match (kind, request) {
            (0x80, 6) => descriptor(value, &self.name, &self.serial),
            (0x80..=0x82, 0) => Some(vec![0, 0]),
            (0x80, 8) => Some(vec![1]),
            (0x81, 10) => Some(vec![u8::from(self.streaming.is_some())]),
            (0x01, 11) => {
                self.set_interface(index_low, value_low);
                Some(Vec::new())
            }
            // Set configuration; set and clear features.
            (0x00..=0x02, 1 | 3 | 9) => Some(Vec::new()),
            (0x21 | 0xA1, _) if index_low == CONTROL_INTERFACE => {
                let mut state = lock(&self.state);
                if (index_high, value_high, request) == (0, REQUEST_ERROR_CODE, GET_CUR) {
                    return Some(vec![state.controls.last_error()]);
                }
                state.controls.answer(request, (index_high, value_high), data)
            }
            (0x21 | 0xA1, _) if index_low == STREAMING_INTERFACE => self.negotiate(request, value_high, data),
            _ => None,
        }
    }

    fn negotiate(&mut self, request: u8, selector: u8, data: &[u8]) -> Option<Vec<u8>> {
        let agreement = match selector {
            PROBE => &mut self.probed,
            COMMIT => &mut self.committed,
            _ => return None,
        };
        match request {
            SET_CUR => {
                *agreement = Negotiated::from_probe(data);
                Some(Vec::new())
            }
            GET_CUR | GET_MIN | GET_MAX | GET_DEF => Some(agreement.to_probe().to_vec()),
            GET_LEN => Some(vec![PROBE_BYTES as u8, 0]),
            GET_INFO => Some(vec![0b11]),
            _ => None,
        }
    }

    /// Alternate setting 1 of the streaming interface starts the stream, 0 stops it.
    fn set_interface(&mut self, interface: u8, setting: u8) {
        if interface != STREAMING_INTERFACE {
            return;
        }
        self.streaming = None;
        if setting == 1 {
            self.frames.begin_stream();
            self.streaming = Some(Streaming {
                agreed: self.committed,
                due: Instant::now(),
                frame: OutgoingFrame::default(),
                sending: false,
                fail_transfer: false,
                odd: false,
            });
        }
    }

    /// Takes the next frame if it is due, and sends as much as the kernel has asked for. Returns how long there is
    /// nothing more to do, unless the kernel asks.
    fn send_what_is_due(&mut self) -> Duration {
        let (hangs, slowness) = {
            let state = lock(&self.state);
            (state.faults.hangs, state.faults.slowness)
        };
        let Some(streaming) = self.streaming.as_mut().filter(|_| !hangs) else {
            return IDLE;
        };
        let now = Instant::now();
        if now >= streaming.due {
            let interval = Duration::from_nanos(u64::from(streaming.agreed.interval_100ns) * 100).mul_f64(slowness);
            streaming.due += interval;
            if now > streaming.due + 4 * interval {
                // After a hang or a long wait there is nothing to catch up with.
                streaming.due = now + interval;
            }
            begin_frame(streaming, &mut self.frames);
        }
        self.send_waiting();
        let due = self.streaming.as_ref().map_or(now, |streaming| streaming.due);
        due.saturating_duration_since(Instant::now())
    }

    fn send_waiting(&mut self) {
        let Some(streaming) = &mut self.streaming else { return };
        while streaming.sending || streaming.fail_transfer {
            let Some(submit) = self.waiting.pop_front() else { return };
            self.results.clear();
            self.payload.clear();
            let status = if std::mem::take(&mut streaming.fail_transfer) {
                streaming.sending = false;
                streaming.frame.length = 0;
                let no_data = |packet: &wire::IsoPacket| wire::IsoResult {
                    packet: *packet,
                    actual_length: 0,
                };
                self.results.extend(submit.packets.iter().map(no_data));
                PROTOCOL_ERROR
            } else {
                let done = streaming
                    .frame
                    .fill(&submit.packets, &mut self.results, &mut self.payload);
                streaming.sending = !done;
                0
            };
            wire::reply_iso(&mut self.outbox, submit.seqnum, status, (&self.results, &self.payload));
        }
    }
}

/// Takes a frame and readies it for sending, with its fault.
fn begin_frame(streaming: &mut Streaming, frames: &mut Frames) {
    let mode = streaming.agreed.mode;
    if streaming.sending {
        frames.overrun(mode);
        return;
    }
    let (fault, start_ns) = frames.take(mode, &mut streaming.frame.picture);
    if fault == Some(FrameFault::LostInSensor) {
        return;
    }
    streaming.odd = !streaming.odd;
    streaming.frame.begin(streaming.odd, start_ns);
    match fault {
        None | Some(FrameFault::LostInSensor) => {}
        Some(FrameFault::ErrorBit) => streaming.frame.error = true,
        Some(FrameFault::Short) => streaming.frame.length /= 2,
        Some(FrameFault::TransferError) => streaming.fail_transfer = true,
    }
    streaming.sending = true;
}
