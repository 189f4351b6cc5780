# Read by process 1 of the virtual machine that scripts/vm starts: builds the guest's root from the
# host's, runs the command, hands its output and its status out, and switches the machine off.
#
# The caller has set:
#   FSTYPE   the file system that shares the host's folders: hostfs (User-Mode Linux) or 9p (QEMU)
#   LOWER    where the host's root is     TOP  an empty folder for the guest's own root
#   BUSYBOX  a static busybox             RUN  the host's folder for this run
#   MODULES  a folder of kernel modules to load, in this order (hostfs; QEMU has loaded its own)
# Folders to share are in $RUN/shares, one a line; $RUN is the first of them.

# Every call of a program costs some 10 ms in there: the fewer, the sooner the command starts.
b() { "$BUSYBOX" "$@"; }

# Sets OUT and ERR, the devices in /dev that lead to the host's two streams.
find_streams() {
    case $FSTYPE in
        hostfs) OUT=ttyS0 ERR=ttyS1 ;;
        9p)
            for port in /sys/class/virtio-ports/*; do
                read -r name <"$port/name" && eval "$name=${port##*/}"
            done
            ;;
    esac
}

# Makes a stream's device pass all bytes as they are; a terminal does it when all before are sent.
settle_stream() {
    case $FSTYPE in hostfs) b stty -F "$ROOT/dev/$1" raw -echo ;; esac
}

# A virtio port takes more than its reader has read, and forgets it when the machine goes off: waits
# until the host says that it has got all.
await_host() {
    case $FSTYPE in hostfs) return ;; esac
    b mount -t debugfs debug "$ROOT/sys/kernel/debug"
    for port in "$OUT" "$ERR"; do
        b sed -n 's/^bytes_sent: //p' "$ROOT/sys/kernel/debug/virtio-ports/$port"
    done >"$ROOT$RUN/sending"
    b mv "$ROOT$RUN/sending" "$ROOT$RUN/sent"
    until [ -e "$ROOT$RUN/taken" ]; do b sleep 0.05; done
}

share_folder() { # NUMBER FOLDER
    case $FSTYPE in
        hostfs) b mount -t hostfs -o "$2" none "$ROOT$2" ;;
        9p) b mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=mmap "share$1" "$ROOT$2" ;;
    esac
}

load_modules() {
    [ "$FSTYPE" = hostfs ] || return 0
    b mount -t proc proc /proc
    for module in "$MODULES"/*; do b insmod "$module"; done
}

# The host's files, read-only, under a memory file system that takes what the command writes.
make_root() {
    b mount -t tmpfs -o mode=755,size=75% upper "$TOP"
    b mkdir "$TOP/upper" "$TOP/work" "$TOP/root"
    b mount -t overlay -o "lowerdir=$LOWER,upperdir=$TOP/upper,workdir=$TOP/work,xino=off" root "$TOP/root"
    ROOT=$TOP/root
}

make_system_folders() {
    b mkdir -p "$ROOT/dev" "$ROOT/proc" "$ROOT/sys" "$ROOT/run"
    b mount -t devtmpfs dev "$ROOT/dev"
    b mount -t tmpfs -o mode=755 run "$ROOT/run"
    b mkdir -p "$ROOT/dev/pts" "$ROOT/dev/shm" "$ROOT/run/lock"
    b mount -t devpts -o ptmxmode=666,gid=5,mode=620 pts "$ROOT/dev/pts"
    b mount -t tmpfs -o mode=1777 shm "$ROOT/dev/shm"
    b mount -t proc proc "$ROOT/proc"
    b mount -t sysfs sys "$ROOT/sys"
    b ln -sfn pts/ptmx "$ROOT/dev/ptmx"
    b ln -sfn /proc/self/fd "$ROOT/dev/fd"
    b ln -sfn fd/0 "$ROOT/dev/stdin"
    b ln -sfn fd/1 "$ROOT/dev/stdout"
    b ln -sfn fd/2 "$ROOT/dev/stderr"
}

share_folders() {
    number=0
    while IFS= read -r folder; do
        b mkdir -p "$ROOT$folder"
        share_folder "$number" "$folder" || return 1
        number=$((number + 1))
    done <"$LOWER$RUN/shares"
}

make_buses() {
    b ip link set lo up
    for bus in vcan0 vcan1; do
        b ip link add "$bus" type vcan && b ip link set "$bus" mtu 72 && b ip link set "$bus" up || return 1
    done
    b hostname axistwin-vm
}

# The command's streams are pipes, as under any other program: were they the devices themselves,
# the command would think that it talks to a terminal.  ("b cat &" would be a shell with a child, and
# end_leftovers needs the number of the child.)
start_relays() {
    find_streams
    settle_stream "$OUT"
    settle_stream "$ERR"
    b mkfifo "$ROOT/run/out" "$ROOT/run/err"
    "$BUSYBOX" cat "$ROOT/run/out" >"$ROOT/dev/$OUT" &
    relay_out=$!
    "$BUSYBOX" cat "$ROOT/run/err" >"$ROOT/dev/$ERR" &
    relay_err=$!
}

# What the command left in the background would keep its streams open for ever.
end_leftovers() {
    for pass in 1 2; do
        for process in "$ROOT"/proc/[0-9]*; do
            process=${process##*/}
            case " 1 $relay_out $relay_err " in
                *" $process "*) ;;
                *) kill -KILL "$process" 2>/dev/null ;;
            esac
        done
    done
}

run_command() {
    : >"$ROOT$RUN/started"
    # In parentheses, so that this shell's own word about a signal is not in the command's stderr.
    (
        exec "$BUSYBOX" setsid "$BUSYBOX" chroot "$ROOT" /bin/sh "$RUN/command" \
            <"$ROOT/dev/null" >"$ROOT/run/out" 2>"$ROOT/run/err"
    )
    status=$?
    end_leftovers
    wait "$relay_out" "$relay_err"
    settle_stream "$OUT"
    settle_stream "$ERR"
    await_host
    echo "$status" >"$ROOT$RUN/status"
    b sync
}

load_modules && make_root && make_system_folders && share_folders && make_buses && start_relays && run_command
b poweroff -f
