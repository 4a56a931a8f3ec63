#!/bin/busybox sh
# First process of the virtual machine that scripts/driver-vm.sh boots: loads the drivers, mounts the host's files
# and runs the program, chrooted into them. Leaves its exit status in the run folder and ends the machine.
export PATH=/bin
/bin/busybox --install /bin

# Ends QEMU through its debug-exit device (one byte to port 0xf4), which is quicker and quieter than a reboot.
end() {
    sync
    printf '\0' | dd of=/dev/port bs=1 seek=244 2>/dev/null
    reboot -f
}

die() {
    echo "driver-vm: $1"
    end
}

mount -t devtmpfs dev /dev
mount -t proc proc /proc
mount -t sysfs sys /sys

# Two webcams of vivid, no radio, no video output. Start-of-exposure stamps are set by the tests that want them.
vivid_parameters='n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0,0'
while read -r module; do
    case $module in
        vivid.ko) parameters=$vivid_parameters ;;
        *) parameters= ;;
    esac
    insmod "/modules/$module" $parameters || die "cannot load the kernel module $module"
done </order

share() {
    mount -t 9p -o "trans=virtio,version=9p2000.L,msize=524288,$3" "$1" "$2" || die "cannot mount the shared folder $1"
}
mkdir -p /run
share run /run cache=none
. /run/command
share host /host ro,cache=loose

mount --bind /sys /host/sys
mount --bind /dev /host/dev
mount -t proc proc /host/proc
mkdir -p /dev/shm
# The program may lie in the host's /tmp, which the machine's own is about to cover.
mkdir /program
mount --bind "/host$PROGRAM_FOLDER" /program
for folder in run tmp dev/shm; do
    mount -t tmpfs -o mode=1777 tmpfs "/host/$folder"
done
mkdir -p "/host$RESULTS" "/host$PROGRAM_FOLDER"
mount --move /program "/host$PROGRAM_FOLDER"
share results "/host$RESULTS" cache=mmap
# For tests that load a driver anew with other parameters.
mkdir -p /host/run/driver-vm
cp -r /modules /bin/busybox /host/run/driver-vm/
ifconfig lo up

# /run/command is sourced out here and run in there.
cp /run/command /host/run/driver-vm/command
chroot /host /run/driver-vm/busybox sh -c '. /run/driver-vm/command; run_program'
status=$?

dmesg >"/host$RESULTS/dmesg.log"
echo $status >/run/status
end
