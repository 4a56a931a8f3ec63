#!/usr/bin/env bash
# Boots Debian's kernel in QEMU and runs a program in there, beside real camera drivers: vivid (two devices),
# uvcvideo, and vhci_hcd, through which the program can plug in simulated USB webcams.
# The exit status is the program's. Needs no root, no KVM and, once the kernel is fetched, no network.
#
# The program sees the file system of this machine under the same paths, read-only: dynamic libraries, recordings
# and further programs are simply there. /dev, /proc, /sys, /run, /tmp and /dev/shm are the virtual machine's own.
# Only the results folder can be written to, and stays.
#
# usage: scripts/driver-vm.sh [OPTION]... PROGRAM [ARGUMENT]...
#        scripts/driver-vm.sh --prepare
#   --prepare        fetch the kernel and build the initramfs only
#   --timeout S      kill the virtual machine after S seconds (default 170)
#   --results DIR    a folder to write to (default target/driver-vm/results); afterwards also dmesg.log
#   --env NAME=VALUE an environment variable for the program; MIRRORBALL_RESULTS and RUST_LOG are handed on anyway
#   --cpus N         processors of the machine (default 1, which is the fastest without KVM)
#
# exit status besides the program's: 70 the machine did not finish, 75 it cannot be built or booted here, 2 usage
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
init="$here/scripts/driver-vm-init.sh"
cache="${CARGO_TARGET_DIR:-$here/target}/driver-vm"

# What the machine loads at boot, with what these depend on. The 9p ones first: they bring the host's files.
modules=(virtio_pci 9pnet_virtio 9p uvcvideo vhci-hcd vivid)

usage() {
    sed -n '/^# usage:/,/^# exit status/s/^# \{0,1\}//p' "$0" >&2
    exit 2
}

cannot() {
    echo "error: $1" >&2
    shift
    [ $# -eq 0 ] || printf '  hint: %s\n' "$@" >&2
    exit 75
}

check_tools() {
    local missing=() tool
    for tool in qemu-system-x86_64 busybox depmod modprobe cpio xz dpkg-deb apt-get flock; do
        PATH="$PATH:/usr/sbin:/sbin" command -v "$tool" >/dev/null || missing+=("$tool")
    done
    [ "$(uname -m)" = x86_64 ] || cannot "the virtual machine with camera drivers is for x86_64, this is $(uname -m)"
    [ ${#missing[@]} -eq 0 ] ||
        cannot "the virtual machine with camera drivers needs \`${missing[*]}\`" \
            "run scripts/setup.sh, or: apt-get install --no-install-recommends qemu-system-x86 kmod busybox-static cpio"
}

# Prints the name of the versioned package behind linux-image-amd64; the cloud kernel has no camera drivers.
kernel_package() {
    { apt-cache "${apt_options[@]}" depends linux-image-amd64 2>/dev/null || true; } |
        sed -n '0,/^ *Depends: \(linux-image-[0-9].*-amd64\)$/s//\1/p' | tail -n 1
}

# Turns to package lists of our own: the system's are missing (in a container, say) or older than the archive.
use_own_lists() {
    mkdir -p "$cache/apt/lists/partial" "$cache/apt/archives/partial"
    apt_options=(-o "Dir::State::Lists=$cache/apt/lists" -o "Dir::Cache=$cache/apt")
    package=$(kernel_package)
}

# Downloads `package` if it is not there.
fetch_kernel() {
    [ -n "$package" ] || return 1
    kernel="$cache/$package"
    mkdir -p "$kernel"
    compgen -G "$kernel/*.deb" >/dev/null && return
    echo "fetching $package (70 MB)" >&2
    # apt drops its privileges and warns where its own user may not write.
    (cd "$kernel" && apt-get "${apt_options[@]}" -q -o APT::Sandbox::User=root download "$package" >&2)
}

# Sets `package` and `kernel`, and fetches the kernel: the system's lists first, fresh ones if these are of no use, and
# without network any kernel fetched earlier.
find_kernel() {
    apt_options=()
    package=$(kernel_package)
    fetch_kernel && return
    use_own_lists
    fetch_kernel && return
    apt-get "${apt_options[@]}" update >/dev/null || true
    package=$(kernel_package)
    fetch_kernel && return
    package=$(cd "$cache" && for deb in linux-image-*/*.deb; do [ -f "$deb" ] && dirname "$deb"; done | tail -n 1)
    fetch_kernel || cannot "cannot download Debian's package \`linux-image-amd64\` to take the kernel from" \
        "this needs Debian and its package archive; see what apt-get says above"
}

# Takes the kernel out of its bzImage: QEMU starts the plain ELF file at half the processor time.
extract_vmlinux() {
    local offset
    for offset in $(LC_ALL=C grep --text --byte-offset --only-matching --perl-regexp '\xFD7zXZ\x00' "$1" | cut -d: -f1); do
        tail -c "+$((offset + 1))" "$1" | xz --decompress --stdout --single-stream >"$2" 2>/dev/null || true
        [ "$(head -c 4 "$2" | tail -c 3)" != ELF ] || return 0
    done
    cannot "no XZ-packed kernel in \`$1\`" "this Debian packs its kernel otherwise; extend extract_vmlinux in $0"
}

# Copies the modules into initramfs/modules and writes their order of loading to initramfs/order.
pick_modules() {
    local unpacked=$1 root=$2 version=$3 module path file
    mkdir -p "$root/modules"
    depmod -b "$unpacked" "$version"
    : >"$root/order"
    for module in "${modules[@]}"; do
        modprobe -d "$unpacked" -S "$version" --show-depends "$module" 2>/dev/null | sed -n 's/^insmod \([^ ]*\).*/\1/p' |
            while read -r path; do
                file=$(basename "$path")
                case $file in
                    *.xz) file=${file%.xz} && xz --decompress --stdout "$path" >"$root/modules/$file" ;;
                    *) cp "$path" "$root/modules/" ;;
                esac
                grep -qx "$file" "$root/order" || echo "$file" >>"$root/order"
            done
        # A driver that is built into the kernel prints `builtin`, one that does not exist prints nothing.
        modprobe -d "$unpacked" -S "$version" --show-depends "$module" >/dev/null 2>&1 ||
            cannot "the kernel \`$package\` has no module \`$module\`"
    done
}

build() {
    local unpacked="$kernel/unpacked" root="$kernel/initramfs" version=${package#linux-image-} busybox
    PATH="$PATH:/usr/sbin:/sbin"
    echo "unpacking $package" >&2
    rm -rf "$unpacked" "$root" "$kernel/complete"
    mkdir -p "$unpacked" "$root"/{dev,proc,sys,host,bin}
    dpkg-deb -x "$kernel"/*.deb "$unpacked"
    extract_vmlinux "$unpacked/boot/vmlinuz-$version" "$kernel/vmlinux"
    pick_modules "$unpacked" "$root" "$version"
    busybox=$(command -v busybox)
    if ldd "$busybox" >/dev/null 2>&1; then
        cannot "\`$busybox\` is not statically linked" "install the package busybox-static"
    fi
    cp "$busybox" "$root/bin/busybox"
    install -m 755 "$init" "$root/init"
    (cd "$root" && find . | cpio --quiet --create --format=newc) >"$kernel/initramfs.cpio"
    rm -rf "$unpacked" "$root"
    touch "$kernel/complete"
}

# Fetches and builds what is missing or older than these scripts; one process at a time.
prepare() {
    mkdir -p "$cache"
    exec 9>"$cache/lock"
    flock 9
    find_kernel
    if [ ! "$kernel/complete" -nt "$0" ] || [ ! "$kernel/complete" -nt "$init" ]; then
        build
    fi
    exec 9>&-
}

# Writes what the init script reads: folders, environment and command.
write_command() {
    local run=$1 program=$2
    shift 2
    {
        printf 'RESULTS=%q\nPROGRAM_FOLDER=%q\n' "$results" "$(dirname "$program")"
        printf 'run_program() {\n    cd %q || return 70\n    env -i PATH=/usr/local/bin:/usr/bin:/bin HOME=/tmp \\\n' "$PWD"
        printf '        MIRRORBALL_RESULTS=%q RUST_BACKTRACE=1 \\\n' "$results"
        [ -z "${RUST_LOG-}" ] || printf '        RUST_LOG=%q \\\n' "$RUST_LOG"
        [ ${#environment[@]} -eq 0 ] || printf '        %q \\\n' "${environment[@]}"
        printf '        '
        printf '%q ' "$program" "$@"
        printf '\n}\n'
    } >"$run/command"
}

boot() {
    local run=$1
    # -erms,-fsrm: the C library then copies with vector moves, which QEMU translates well.
    timeout --kill-after=5 "$timeout_s" qemu-system-x86_64 \
        -machine q35 -accel tcg,thread=multi -smp "$cpus" -cpu max,-erms,-fsrm -m 1024 \
        -nodefaults -display none -serial stdio -no-reboot \
        -device isa-debug-exit,iobase=0xf4,iosize=4 \
        -kernel "$kernel/vmlinux" -initrd "$kernel/initramfs.cpio" \
        -append "console=ttyS0 loglevel=3 panic=-1 nokaslr mitigations=off no_timer_check tsc=reliable random.trust_cpu=on \
apparmor=0 audit=0 cryptomgr.notests nmi_watchdog=0 usbcore.autosuspend=-1" \
        -fsdev local,id=host,path=/,security_model=none,readonly=on,multidevs=remap \
        -device virtio-9p-pci,fsdev=host,mount_tag=host \
        -fsdev local,id=run,path="$run",security_model=none -device virtio-9p-pci,fsdev=run,mount_tag=run \
        -fsdev local,id=results,path="$results",security_model=none \
        -device virtio-9p-pci,fsdev=results,mount_tag=results \
        </dev/null
}

mode=run timeout_s=170 cpus=1 results="$cache/results" environment=()
while [ $# -gt 0 ]; do
    case $1 in
        --prepare) mode=prepare ;;
        --timeout | --results | --env | --cpus)
            [ $# -gt 1 ] || usage
            case $1 in
                --timeout) timeout_s=$2 ;;
                --results) results=$2 ;;
                --env) environment+=("$2") ;;
                --cpus) cpus=$2 ;;
            esac
            shift
            ;;
        -*) usage ;;
        *) break ;;
    esac
    shift
done

check_tools
[ $mode = prepare ] || [ $# -gt 0 ] || usage
prepare
[ $mode != prepare ] || exit 0

if ! program=$(command -v "$1"); then
    echo "error: there is no program \`$1\`" >&2
    exit 2
fi
program=$(realpath "$program")
shift
mkdir -p "$results"
results=$(realpath "$results")
run=$(mktemp -d "$cache/run.XXXXXX")
trap 'rm -rf "$run"' EXIT
write_command "$run" "$program" "$@"

qemu_status=0
boot "$run" || qemu_status=$?
if [ -s "$run/status" ]; then
    exit "$(cat "$run/status")"
elif [ $qemu_status -eq 124 ] || [ $qemu_status -eq 137 ]; then
    echo "error: the virtual machine was killed: not done after \`$timeout_s\` seconds" >&2
else
    echo "error: the virtual machine ended without a result (QEMU exit status $qemu_status)" >&2
fi
exit 70
