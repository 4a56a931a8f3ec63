#!/usr/bin/env bash
# Installs what Debian packages are missing and checks the Rust toolchain.
# Says what it does; says and does nothing, and needs no network, when all is there.
#
# usage: scripts/setup.sh [--window] [--no-drivers] [--no-browser]
#   --window      also the libraries that `mirrorball-render --window` loads at run time
#   --no-drivers  not the virtual machine in which the tests on real camera drivers run; they are skipped then
#   --no-browser  not the browser in which calibration reports are tested (300 MB); that test is skipped then
set -euo pipefail
cd "$(dirname "$0")/.."

# The compilers: C for the AprilTag library, C++ for the FLIP metric.
# libclang and the kernel's headers: the bindings to V4L2 are made from these when building.
# The Vulkan loader, and drivers for it. They bring the software adapter lavapipe and stand beside any other driver:
# the programs choose the fastest adapter they find.
packages=(build-essential libclang-dev linux-libc-dev libvulkan1 mesa-vulkan-drivers ca-certificates curl)
# QEMU and what puts a kernel together for it: scripts/driver-vm.sh.
driver_packages=(qemu-system-x86 kmod busybox-static cpio xz-utils)
browser_packages=(chromium fonts-dejavu-core)
window_packages=(libxkbcommon0 libxkbcommon-x11-0 libwayland-client0 libx11-6 libx11-xcb1 libxcursor1 libxi6 libxrandr2)

fail() {
    echo "error: $1" >&2
    shift
    printf '  hint: %s\n' "$@" >&2
    exit 1
}

is_installed() {
    [ "$(dpkg-query --show --showformat='${db:Status-Status}' "$1" 2>/dev/null)" = installed ]
}

install_missing() {
    local missing=() package
    for package in "${packages[@]}"; do
        is_installed "$package" || missing+=("$package")
    done
    if [ ${#missing[@]} -eq 0 ]; then
        return
    fi
    echo "installing Debian packages: ${missing[*]}"
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null ||
            fail "Debian packages are missing, and there is no \`sudo\` to install them" \
                "run as root: apt-get install --no-install-recommends ${missing[*]}"
        as_root=(sudo)
    fi
    "${as_root[@]}" apt-get update
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends "${missing[@]}"
}

check_rust() {
    local needed found
    needed=$(sed -n 's/^rust-version = "\(.*\)"$/\1/p' Cargo.toml)
    if ! command -v cargo >/dev/null; then
        if [ -x "$HOME/.cargo/bin/cargo" ]; then
            fail "\`cargo\` is not on the PATH" "run: . \"\$HOME/.cargo/env\""
        fi
        fail "there is no Rust toolchain; Rust $needed or newer is needed (Debian 12 ships an older one)" \
            "install rustup as https://rustup.rs says: curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh"
    fi
    found=$(rustc --version | cut -d ' ' -f 2)
    if ! printf '%s\n%s\n' "$needed" "${found%%-*}" | sort --version-sort --check=quiet; then
        fail "Rust $found is too old; $needed or newer is needed" "run: rustup update stable"
    fi
}

drivers=yes
browser=yes
# Any browser of this kind will do.
if command -v chromium chromium-browser google-chrome >/dev/null; then browser=no; fi
# The virtual machine is for this architecture only.
[ "$(uname -m)" = x86_64 ] || drivers=no
for option in "$@"; do
    case $option in
        --window) packages+=("${window_packages[@]}") ;;
        --no-drivers) drivers=no ;;
        --no-browser) browser=no ;;
        *) fail "unknown option \`$option\`" "scripts/setup.sh knows \`--window\`, \`--no-drivers\` and \`--no-browser\`" ;;
    esac
done
if [ $drivers = yes ]; then
    packages+=("${driver_packages[@]}")
fi
if [ $browser = yes ]; then
    packages+=("${browser_packages[@]}")
fi
if command -v dpkg-query >/dev/null; then
    install_missing
else
    echo "no Debian system: see to it that a C and C++ compiler, libclang, the kernel's headers, a Vulkan loader and a Vulkan driver are there"
fi
check_rust
