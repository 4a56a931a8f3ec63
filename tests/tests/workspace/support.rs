//! Where things are, for tests that run the programs.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// A folder below `tests/data`.
pub(crate) fn data(path: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/data")).join(path)
}

/// A program of the workspace, beside this test's own folder in the target directory.
pub(crate) fn program(name: &str) -> Command {
    let test = std::env::current_exe().unwrap();
    let file = test.parent().unwrap().parent().unwrap().join(name);
    assert!(
        file.exists(),
        "`{}` is not built; run the tests of the whole workspace",
        file.display()
    );
    let mut command = Command::new(file);
    command.stdin(Stdio::null()).env("RUST_LOG", "info");
    command
}

/// A child process that does not outlive the test.
pub(crate) struct Running(pub(crate) Child);

impl Running {
    /// Kills it at once, as `kill -9` does.
    pub(crate) fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Whether there is a Vulkan adapter. Without one a test says `SKIPPED: no adapter`, unless that is forbidden.
pub(crate) fn has_adapter() -> bool {
    let found = mirrorball_render::gpu::Gpu::open();
    if let Err(error) = &found {
        assert!(
            std::env::var("MIRRORBALL_REQUIRE_GPU").as_deref() != Ok("1"),
            "MIRRORBALL_REQUIRE_GPU=1, but {error}"
        );
        eprintln!("SKIPPED: no adapter");
    }
    found.is_ok()
}
