//! Which cameras there are, where they are plugged in, and who has them open.
//!
//! The list of nodes is nokhwa's; names of buses, speeds and hubs come from sysfs (`Documentation/ABI/testing/sysfs-bus-usb`).

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use nokhwa::utils::{ApiBackend, CameraIndex};

use super::error::V4l2Error;

/// How a camera is named in configurations and on the command line.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum CameraAddress {
    /// A device node: `/dev/video0`. The number may change when a camera is plugged in again.
    Path(PathBuf),
    /// The camera's own name, and where it is plugged in if there are several: `NAME` or `NAME@usb-0000:00:14.0-1`.
    Card {
        /// Name as in sysfs, without white space at its ends.
        name: String,
        /// Controller and port as `VIDIOC_QUERYCAP` names them.
        bus: Option<String>,
    },
}

impl FromStr for CameraAddress {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        if text.starts_with('/') {
            return Ok(Self::Path(text.into()));
        }
        Ok(match text.rsplit_once("@usb-") {
            Some((name, port)) => Self::Card {
                name: name.into(),
                bus: Some(format!("usb-{port}")),
            },
            None => Self::Card {
                name: text.into(),
                bus: None,
            },
        })
    }
}

impl fmt::Display for CameraAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Path(path) => write!(formatter, "{}", path.display()),
            Self::Card { name, bus: Some(bus) } => write!(formatter, "{name}@{bus}"),
            Self::Card { name, bus: None } => formatter.write_str(name),
        }
    }
}

/// A video node of a camera, as far as it is known without opening it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraNode {
    /// Device node.
    pub path: PathBuf,
    /// Name of the camera.
    pub name: String,
    /// Which of the camera's nodes this is: 0 sends pictures, a second one of a UVC camera metadata.
    pub index: u32,
    /// Where it is plugged in; none for cameras that are not on USB.
    pub usb: Option<UsbPlace>,
}

/// Where a USB camera is plugged in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbPlace {
    /// Controller and port as `VIDIOC_QUERYCAP` names them: `usb-0000:00:14.0-1.2`.
    pub bus: String,
    /// The hub, as the kernel names it: `1-1`; `usb1` is the controller's own.
    pub hub: String,
    /// Number of the USB bus. Cameras on one bus share its bandwidth.
    pub bus_number: u32,
    /// Speed in Mbit/s: 480 for USB 2, 5000 for USB 3.
    pub speed_mbit: u32,
}

impl CameraNode {
    /// The address that stays when the camera is plugged into the same port again.
    #[must_use]
    pub fn address(&self) -> CameraAddress {
        CameraAddress::Card {
            name: self.name.clone(),
            bus: self.usb.as_ref().map(|usb| usb.bus.clone()),
        }
    }

    /// True if the address is that of this node.
    #[must_use]
    pub fn answers_to(&self, address: &CameraAddress) -> bool {
        match address {
            CameraAddress::Path(path) => *path == self.path,
            CameraAddress::Card { name, bus } => {
                let own_bus = self.usb.as_ref().map(|usb| &usb.bus);
                self.index == 0 && *name == self.name && (bus.is_none() || bus.as_ref() == own_bus)
            }
        }
    }
}

/// All video nodes there are, metadata nodes included, in the order of their numbers.
#[must_use]
pub fn list_nodes() -> Vec<CameraNode> {
    let names = if is_listing_safe(Path::new("/dev")) {
        names_from_nokhwa()
    } else {
        BTreeMap::new()
    };
    list_nodes_in(Path::new("/sys/class/video4linux"), &names)
}

/// The node of the one camera that answers to the address.
///
/// # Errors
///
/// No camera or several. A path is not looked for: opening it tells more.
pub fn find(address: &CameraAddress) -> Result<PathBuf, V4l2Error> {
    match address {
        CameraAddress::Path(path) => Ok(path.clone()),
        CameraAddress::Card { .. } => pick(address, &list_nodes()),
    }
}

fn pick(address: &CameraAddress, nodes: &[CameraNode]) -> Result<PathBuf, V4l2Error> {
    let addresses = |nodes: &[&CameraNode]| nodes.iter().map(|node| node.address().to_string()).collect();
    let found: Vec<_> = nodes.iter().filter(|node| node.answers_to(address)).collect();
    match found[..] {
        [node] => Ok(node.path.clone()),
        [] => {
            let present: Vec<_> = nodes.iter().filter(|node| node.index == 0).collect();
            Err(V4l2Error::NoSuchCamera {
                address: address.to_string(),
                present: addresses(&present),
            })
        }
        _ => Err(V4l2Error::Ambiguous {
            address: address.to_string(),
            candidates: addresses(&found),
        }),
    }
}

/// nokhwa's listing panics on any `/dev/video*` that does not end in a number, such as a link of a udev rule.
fn is_listing_safe(dev: &Path) -> bool {
    let Ok(entries) = fs::read_dir(dev) else { return true };
    entries.flatten().all(|entry| {
        let name = entry.file_name();
        let Some(name) = name.to_str() else { return false };
        name.strip_prefix("video")
            .is_none_or(|number| number.parse::<u32>().is_ok())
    })
}

fn names_from_nokhwa() -> BTreeMap<u32, String> {
    let cameras = nokhwa::query(ApiBackend::Video4Linux).unwrap_or_else(|error| {
        tracing::debug!("nokhwa lists no cameras: {error}");
        Vec::new()
    });
    let named = cameras.into_iter().filter_map(|camera| match camera.index() {
        CameraIndex::Index(number) => Some((*number, camera.human_name().trim().to_owned())),
        CameraIndex::String(_) => None,
    });
    named.collect()
}

/// What sysfs tells of each node. It knows nodes that nokhwa does not list, and nokhwa those of drivers without sysfs.
fn list_nodes_in(class: &Path, names: &BTreeMap<u32, String>) -> Vec<CameraNode> {
    let mut nodes: BTreeMap<u32, CameraNode> = names
        .iter()
        .map(|(number, name)| {
            let path = PathBuf::from(format!("/dev/video{number}"));
            (
                *number,
                CameraNode {
                    path,
                    name: name.clone(),
                    index: 0,
                    usb: None,
                },
            )
        })
        .collect();
    for entry in fs::read_dir(class).into_iter().flatten().flatten() {
        let file_name = entry.file_name();
        let number = file_name
            .to_str()
            .and_then(|name| name.strip_prefix("video")?.parse().ok());
        let Some(number) = number else { continue };
        let folder = entry.path();
        let node = CameraNode {
            path: PathBuf::from(format!("/dev/video{number}")),
            name: read(&folder, "name")
                .or_else(|| names.get(&number).cloned())
                .unwrap_or_default(),
            index: read_number(&folder, "index").unwrap_or(0),
            usb: usb_place(&folder),
        };
        nodes.insert(number, node);
    }
    nodes.into_values().collect()
}

/// Follows a video node to its USB interface (`.../0000:00:14.0/usb1/1-1/1-1.2/1-1.2:1.0`) and reads what is above it.
fn usb_place(folder: &Path) -> Option<UsbPlace> {
    let interface = fs::canonicalize(folder.join("device")).ok()?;
    let device = interface.parent()?;
    let port = read(device, "devpath")?;
    let root = device
        .ancestors()
        .find(|path| file_name(path).is_some_and(is_root_hub))?;
    Some(UsbPlace {
        bus: format!("usb-{}-{port}", file_name(root.parent()?)?),
        hub: file_name(device.parent()?)?.to_owned(),
        bus_number: read_number(device, "busnum")?,
        speed_mbit: read_number(device, "speed")?,
    })
}

fn is_root_hub(name: &str) -> bool {
    name.strip_prefix("usb")
        .is_some_and(|number| number.parse::<u32>().is_ok())
}

fn file_name(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

fn read(folder: &Path, name: &str) -> Option<String> {
    let bytes = fs::read(folder.join(name)).ok()?;
    Some(String::from_utf8_lossy(&bytes).trim().to_owned())
}

fn read_number(folder: &Path, name: &str) -> Option<u32> {
    read(folder, name)?.parse().ok()
}

/// Programs that have a file open, as `name (process 123)`, as far as `/proc` lets this user see.
#[must_use]
pub fn holders_of(path: &Path) -> Vec<String> {
    let own = std::process::id();
    let mut holders = Vec::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(process) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        let open_files = fs::read_dir(entry.path().join("fd")).into_iter().flatten().flatten();
        let has_it = open_files
            .into_iter()
            .any(|file| fs::read_link(file.path()).is_ok_and(|link| link == path));
        if has_it && process != own {
            let name = read(&entry.path(), "comm").unwrap_or_default();
            holders.push(format!("{name} (process {process})"));
        }
    }
    holders
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn write(folder: &Path, files: &[(&str, &str)]) {
        fs::create_dir_all(folder).unwrap();
        for (name, text) in files {
            fs::write(folder.join(name), format!("{text}\n")).unwrap();
        }
    }

    /// A webcam behind a hub with its metadata node, and a camera of a driver without USB.
    fn sysfs() -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        let usb = root.path().join("devices/pci0000:00/0000:00:14.0/usb1/1-4/1-4.2");
        write(&usb, &[("devpath", "4.2"), ("busnum", "1"), ("speed", "480")]);
        let platform = root.path().join("devices/platform/vivid.0");
        for (number, index, device) in [
            (0, 0, usb.join("1-4.2:1.0")),
            (1, 1, usb.join("1-4.2:1.0")),
            (7, 0, platform),
        ] {
            let name = if number == 7 {
                "vivid-000-vid-cap"
            } else {
                "HD Webcam: HD Webcam"
            };
            let node = root.path().join(format!("class/video{number}"));
            write(&node, &[("name", name), ("index", &index.to_string())]);
            fs::create_dir_all(&device).unwrap();
            symlink(device, node.join("device")).unwrap();
        }
        root
    }

    #[test]
    fn sysfs_tells_port_hub_and_speed() {
        let root = sysfs();
        let nodes = list_nodes_in(&root.path().join("class"), &BTreeMap::new());
        assert_eq!(nodes.len(), 3);
        assert_eq!((nodes[1].index, nodes[2].path.to_str()), (1, Some("/dev/video7")));
        let expected = UsbPlace {
            bus: "usb-0000:00:14.0-4.2".into(),
            hub: "1-4".into(),
            bus_number: 1,
            speed_mbit: 480,
        };
        assert_eq!(nodes[0].usb, Some(expected));
        assert_eq!(nodes[2].usb, None);
    }

    #[test]
    fn a_camera_is_found_by_name_and_port() {
        let root = sysfs();
        let nodes = list_nodes_in(&root.path().join("class"), &BTreeMap::new());
        let path = |address: &str| pick(&address.parse().unwrap(), &nodes);
        assert_eq!(path("HD Webcam: HD Webcam").unwrap(), Path::new("/dev/video0"));
        assert_eq!(
            path("HD Webcam: HD Webcam@usb-0000:00:14.0-4.2").unwrap(),
            Path::new("/dev/video0")
        );
        let error = path("HD Webcam: HD Webcam@usb-0000:00:14.0-1").unwrap_err();
        assert!(error.to_string().contains("`vivid-000-vid-cap`"), "{error}");
        let twins = [
            nodes[0].clone(),
            CameraNode {
                path: "/dev/video9".into(),
                ..nodes[0].clone()
            },
        ];
        let error = pick(&"HD Webcam: HD Webcam".parse().unwrap(), &twins).unwrap_err();
        assert!(matches!(error, V4l2Error::Ambiguous { .. }), "{error}");
    }

    #[test]
    fn nodes_that_only_nokhwa_lists_are_kept() {
        let names = BTreeMap::from([(3, "other".to_owned())]);
        let nodes = list_nodes_in(Path::new("/nonexistent"), &names);
        assert_eq!((nodes.len(), &*nodes[0].name), (1, "other"));
    }

    #[test]
    fn links_that_nokhwa_cannot_read_are_noticed() {
        let dev = tempfile::tempdir().unwrap();
        write(dev.path(), &[("video0", ""), ("vide", "")]);
        assert!(is_listing_safe(dev.path()));
        write(dev.path(), &[("video-scene", "")]);
        assert!(!is_listing_safe(dev.path()));
    }

    #[test]
    fn addresses_round_trip() {
        for text in ["/dev/video2", "HD Webcam", "HD@Webcam: x", "C920@usb-0000:00:14.0-1.2"] {
            assert_eq!(text.parse::<CameraAddress>().unwrap().to_string(), text);
        }
    }
}
