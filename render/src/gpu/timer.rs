//! Milliseconds per pass, measured by the GPU itself.

use super::Gpu;
use super::readback::Readback;
use crate::error::RenderError;

/// Most passes timed in a frame.
const MAX_PASSES: usize = 128;

/// Time stamps around passes; does nothing where the adapter has none.
#[derive(Debug)]
pub struct Timer {
    queries: Option<(wgpu::QuerySet, Readback)>,
    names: Vec<&'static str>,
    /// Whether this frame's time stamps were copied.
    is_recorded: bool,
    period_ns: f32,
}

impl Timer {
    /// Room for the passes of one frame.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let queries = gpu.has_timestamps.then(|| {
            let set = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("pass times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_PASSES as u32,
            });
            (set, Readback::for_queries(gpu, "pass times", 16 * MAX_PASSES as u64))
        });
        Self {
            queries,
            names: Vec::with_capacity(MAX_PASSES),
            is_recorded: false,
            period_ns: gpu.queue.get_timestamp_period(),
        }
    }

    /// Forgets the passes of the last frame.
    pub fn start_frame(&mut self) {
        self.names.clear();
        self.is_recorded = false;
    }

    /// Time stamps for work called `name`: one pass, or several in a row.
    pub fn span(&mut self, name: &'static str) -> Span<'_> {
        let index = self.names.len();
        let set = self.queries.as_ref().filter(|_| index < MAX_PASSES).map(|(set, _)| set);
        if set.is_some() {
            self.names.push(name);
        }
        Span {
            set,
            first: 2 * index as u32,
        }
    }

    /// Records the copy of the time stamps, after the frame's last pass.
    pub fn record(&mut self, encoder: &mut wgpu::CommandEncoder) {
        if let Some((set, readback)) = &self.queries
            && !self.names.is_empty()
        {
            encoder.resolve_query_set(set, 0..2 * self.names.len() as u32, readback.buffer(), 0);
            readback.record(encoder);
            self.is_recorded = true;
        }
    }

    /// Milliseconds of each pass, in order, once the work is done; empty where the adapter has no time stamps
    /// or nothing was drawn.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read_ms(&self, gpu: &Gpu) -> Result<Vec<(&'static str, f64)>, RenderError> {
        let Some((_, readback)) = self.queries.as_ref().filter(|_| self.is_recorded) else {
            return Ok(Vec::new());
        };
        let mut ticks = [0u64; 2 * MAX_PASSES];
        readback.read(gpu, &mut ticks)?;
        let mut out: Vec<(&'static str, f64)> = Vec::new();
        for (i, &name) in self.names.iter().enumerate() {
            let ms = ticks[2 * i + 1].saturating_sub(ticks[2 * i]) as f64 * f64::from(self.period_ns) * 1e-6;
            match out.iter_mut().find(|(known, _)| *known == name) {
                Some((_, sum)) => *sum += ms,
                None => out.push((name, ms)),
            }
        }
        Ok(out)
    }
}

/// The two time stamps of a piece of work.
#[derive(Debug, Clone, Copy)]
pub struct Span<'a> {
    set: Option<&'a wgpu::QuerySet>,
    first: u32,
}

/// Which ends of a span a pass carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ends {
    /// The only pass.
    Both,
    /// The first of several.
    Begin,
    /// The last of several.
    End,
    /// One in between.
    Neither,
}

impl Ends {
    /// Ends of pass `index` of `n`.
    #[must_use]
    pub fn of(index: usize, n: usize) -> Self {
        match (index == 0, index + 1 == n) {
            (true, true) => Self::Both,
            (true, false) => Self::Begin,
            (false, true) => Self::End,
            (false, false) => Self::Neither,
        }
    }

    fn indices(self, first: u32) -> (Option<u32>, Option<u32>) {
        let (begin, end) = (Some(first), Some(first + 1));
        match self {
            Self::Both => (begin, end),
            Self::Begin => (begin, None),
            Self::End => (None, end),
            Self::Neither => (None, None),
        }
    }
}

impl<'a> Span<'a> {
    /// Time stamps for a compute pass.
    #[must_use]
    pub fn compute(&self, ends: Ends) -> Option<wgpu::ComputePassTimestampWrites<'a>> {
        let (begin, end) = ends.indices(self.first);
        let query_set = self.set.filter(|_| ends != Ends::Neither)?;
        Some(wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: begin,
            end_of_pass_write_index: end,
        })
    }

    /// Time stamps for a render pass.
    #[must_use]
    pub fn render(&self, ends: Ends) -> Option<wgpu::RenderPassTimestampWrites<'a>> {
        let (begin, end) = ends.indices(self.first);
        let query_set = self.set.filter(|_| ends != Ends::Neither)?;
        Some(wgpu::RenderPassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: begin,
            end_of_pass_write_index: end,
        })
    }
}
