#!/bin/busybox sh
# PID 1 of the guest until systemd is: the host's root read-only below, the staged installation over
# it, memory on top. The job becomes a service, the only thing that the target wants.
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
while read -r module options; do
    # shellcheck disable=SC2086 # options are several words
    insmod "/modules/$module" $options || echo "[init] no $module"
done < /modules/order
mkdir -p /memory /stage /root
for share in host stage; do
    mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,cache=loose,ro $share /$share
done
mount -t tmpfs -o size=75% memory /memory
mkdir /memory/upper /memory/work
mount -t overlay -o lowerdir=/stage:/host,upperdir=/memory/upper,workdir=/memory/work root /root
# What belongs to the host: that it is a container, its disks, its machine id, its own units.
rm -f /root/.dockerenv /root/etc/fstab /root/etc/machine-id
: > /root/etc/machine-id
system=/root/etc/systemd/system
rm -rf $system/*.wants
for unit in systemd-tmpfiles-setup.service systemd-tmpfiles-setup-dev.service \
    systemd-tmpfiles-clean.timer systemd-timesyncd.service systemd-update-utmp.service \
    systemd-random-seed.service systemd-networkd.service systemd-resolved.service \
    systemd-logind.service systemd-hwdb-update.service systemd-journal-catalog-update.service \
    systemd-firstboot.service systemd-sysusers.service systemd-update-done.service \
    systemd-journal-flush.service ldconfig.service apparmor.service; do
    ln -sf /dev/null "$system/$unit"
done
cp /job /root/etc/rig-job
cat > $system/rig.service <<'UNIT'
[Unit]
After=basic.target systemd-udevd.service
[Service]
ExecStart=/bin/sh /etc/rig-job
ExecStopPost=/bin/systemctl --force --force poweroff
StandardOutput=tty
StandardError=tty
TTYPath=/dev/console
UNIT
printf '[Unit]\nRequires=basic.target rig.service\nAfter=basic.target\nAllowIsolate=yes\n' > $system/rig.target
echo "[init] systemd $(cut -d' ' -f1 /proc/uptime) s after boot"
mount --move /dev /root/dev
umount /sys /proc
exec switch_root /root /lib/systemd/systemd --unit=rig.target --show-status=no --log-target=kmsg
