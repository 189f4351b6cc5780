#!/bin/busybox sh
# Process 1 of the guest in QEMU.  At first it sees only the archive that it came in: busybox and the
# kernel's modules.  It finds the host's files, and there what scripts/vm has written for this run.
b() { /bin/busybox "$@"; }
b mount -t devtmpfs dev /dev
b mount -t proc proc /proc
b mount -t sysfs sys /sys
exec </dev/null >/dev/console 2>&1
for module in /modules/*; do b insmod "$module"; done
b mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=512000,cache=loose host /host
. "/host$axistwin_run/init"
