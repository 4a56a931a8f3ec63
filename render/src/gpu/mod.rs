//! The graphics device and what every pass needs of it.

pub mod memory;
pub mod pass;
pub mod readback;
pub mod shader;
pub mod timer;
pub mod types;

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

use crate::error::RenderError;

/// A device, its queue, and what it is called.
#[derive(Debug, Clone)]
pub struct Gpu {
    /// The instance, for surfaces.
    pub instance: wgpu::Instance,
    /// The adapter, for surface formats.
    pub adapter: wgpu::Adapter,
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Name of the adapter and its driver, for reports.
    pub name: String,
    /// Whether passes can be timed on the device.
    pub has_timestamps: bool,
    /// Buffers, textures, pipelines, samplers and bindings made so far.
    n_made: Arc<AtomicU64>,
    /// The first thing that the device complained of.
    complaint: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the fastest Vulkan adapter; a software one when there is no other.
    ///
    /// # Errors
    /// [`RenderError::NoAdapter`] without a Vulkan driver, [`RenderError::NoDevice`] when it refuses the device.
    pub fn open() -> Result<Self, RenderError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::VULKAN;
        let instance = wgpu::Instance::new(descriptor);
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..wgpu::RequestAdapterOptions::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|source| RenderError::NoAdapter { source })?;
        let info = adapter.get_info();
        let has_timestamps = adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("render node"),
            required_features: if has_timestamps {
                wgpu::Features::TIMESTAMP_QUERY
            } else {
                wgpu::Features::empty()
            },
            required_limits: adapter.limits(),
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|source| RenderError::NoDevice {
            adapter: info.name.clone(),
            source,
        })?;
        let name = format!("{} ({} {})", info.name, info.driver, info.driver_info);
        let complaint = Arc::new(Mutex::new(None));
        let noted = complaint.clone();
        // Without a handler wgpu panics; with it the next wait says what was wrong.
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            noted
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .get_or_insert_with(|| error.to_string());
        }));
        Ok(Self {
            instance,
            adapter,
            device,
            queue,
            name,
            has_timestamps,
            n_made: Arc::new(AtomicU64::new(0)),
            complaint,
        })
    }

    /// Waits until all submitted work is done.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost or complained since it was opened.
    pub fn wait(&self, during: &'static str) -> Result<(), RenderError> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|error| RenderError::Gpu {
                during,
                message: error.to_string(),
            })?;
        self.check(during)
    }

    /// Refuses `wanted` when it is above a `limit` of the adapter.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`].
    pub fn within(&self, what: &'static str, wanted: u64, limit: u64) -> Result<(), RenderError> {
        if wanted <= limit {
            return Ok(());
        }
        Err(RenderError::TooLarge {
            what,
            wanted,
            limit,
            adapter: self.name.clone(),
        })
    }

    /// Reports what the device complained of, if it did.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] with the first complaint.
    pub fn check(&self, during: &'static str) -> Result<(), RenderError> {
        let complaint = self.complaint.lock().unwrap_or_else(PoisonError::into_inner);
        complaint.as_ref().map_or(Ok(()), |message| {
            Err(RenderError::Gpu {
                during,
                message: message.clone(),
            })
        })
    }
}
