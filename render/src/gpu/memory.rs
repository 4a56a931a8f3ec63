//! What the GPU holds: how many objects were made, and how much memory is in use.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use super::Gpu;

/// Memory of the device in use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Memory {
    /// Bytes of all buffers and textures.
    pub used_bytes: u64,
    /// Bytes that are reserved for them, a little more.
    pub reserved_bytes: u64,
    /// Bytes by the first part of the label (`pass name: what`), in its order; what wgpu makes for itself, as for uploads,
    /// is left out.
    pub by_pass: BTreeMap<String, u64>,
}

impl Memory {
    /// Bytes of everything but what wgpu makes for itself.
    #[must_use]
    pub fn own_bytes(&self) -> u64 {
        self.by_pass.values().sum()
    }
}

impl Gpu {
    /// The memory in use now; `None` where the driver's allocator tells nothing.
    #[must_use]
    pub fn memory(&self) -> Option<Memory> {
        let report = self.device.generate_allocator_report()?;
        let mut by_pass = BTreeMap::new();
        for allocation in report.allocations.iter().filter(|a| !a.name.starts_with("(wgpu")) {
            let pass = allocation.name.split(':').next().unwrap_or_default().trim();
            *by_pass.entry(pass.to_owned()).or_insert(0) += allocation.size;
        }
        Some(Memory {
            used_bytes: report.total_allocated_bytes,
            reserved_bytes: report.total_reserved_bytes,
            by_pass,
        })
    }

    /// Buffers, textures, pipelines, samplers and sets of bindings made since the device was opened.
    #[must_use]
    pub fn n_made(&self) -> u64 {
        self.n_made.load(Ordering::Relaxed)
    }

    /// Counts one more object. A count of its own, so it orders nothing.
    pub(super) fn count_made(&self) {
        self.n_made.fetch_add(1, Ordering::Relaxed);
    }
}
