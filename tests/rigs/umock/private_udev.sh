# sh private_udev.sh RULES COMMAND...: with RULES installed, in a mount namespace of its own where
# /dev, /run and /etc/udev are empty: `udevadm test` writes symlinks and a database for real.
set -e
rules=$1
shift
mount -n -t tmpfs private /run
mkdir -p /run/dev
for name in null zero urandom; do
    : >"/run/dev/$name"
    mount -n --bind "/dev/$name" "/run/dev/$name"
done
mount -n --rbind /run/dev /dev
mount -n -t tmpfs private /etc/udev
mkdir -p /etc/udev/rules.d
cp "$rules" /etc/udev/rules.d/
[ ! -e /dev/ptmx ] # /dev is private by now, or this ends here
exec "$@"
