#!/bin/busybox sh
# PID 1 of the guest: load the modules, enter the host's root read-only, run the job, power off.
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
while read -r module options; do
    # shellcheck disable=SC2086 # options are several words
    insmod "/modules/$module" $options || echo "[init] no $module"
done < /modules/order
ip link set lo up
mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,cache=loose,ro host /host
# Before the binds below: they take along what is mounted by then.
mkdir -p /dev/pts /dev/shm
mount -t devpts pts /dev/pts
mount -t tmpfs shm /dev/shm
mount -t configfs config /sys/kernel/config
mount -t proc proc /host/proc
mount --rbind /sys /host/sys
mount --rbind /dev /host/dev
# The host's /run speaks of the host's devices.
mount -t tmpfs run /host/run
cp /job /host/dev/shm/job
echo "[init] ready $(cut -d' ' -f1 /proc/uptime) s after boot"
chroot /host /bin/sh /dev/shm/job
echo "[init] job ended with $?, $(cut -d' ' -f1 /proc/uptime) s after boot"
poweroff -f
