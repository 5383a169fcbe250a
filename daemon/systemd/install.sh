#!/bin/sh
# make install, make uninstall: the daemon in a virtual environment of its own under /opt/ertis,
# its units, the udev rule and a configuration. DESTDIR stages it all in a folder, for packages.
set -eu
cd "$(dirname "$0")/../.."

root=${DESTDIR:-}
opt=$root/opt/ertis
units=$root/etc/systemd/system
rule=$root/etc/udev/rules.d/70-ertis.rules
config=$root/etc/ertis/ertis.yaml
example=$opt/share/ertis/ertis.yaml
link=$root/usr/local/bin/ertis

fail() {
    echo "ertis: $*" >&2
    exit 1
}

check_python() {
    found=$("$PYTHON" -c 'import os, sys; print(os.path.realpath(sys.base_prefix))') ||
        fail "no Python: $PYTHON; name one with PYTHON=/usr/bin/python3"
    case $found/ in
    /root/* | /home/* | /tmp/*)
        fail "$PYTHON lives in $found, which the service cannot see (ProtectHome, PrivateTmp);" \
            "name one that all can see: make install PYTHON=/usr/bin/python3"
        ;;
    esac
    "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null ||
        fail "$PYTHON makes no virtual environments: apt install python3-venv"
    "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 10))' ||
        fail "$PYTHON is too old, expected Python 3.10 or newer"
}

check_place() {
    if [ -e "$opt" ] && [ ! -e "$opt/pyvenv.cfg" ]; then
        fail "$opt exists and is no installation of ertis: move it away"
    fi
    install -d "$opt" 2>/dev/null && [ -w "$opt" ] ||
        fail "cannot write $opt: run as root (sudo make install), or stage it with DESTDIR="
}

install_code() {
    "$PYTHON" -m venv "$opt"
    "$opt/bin/python" -m pip install --quiet --disable-pip-version-check \
        --no-warn-script-location ".[${EXTRAS:-ros2}]"
    if [ -n "$root" ]; then # what pip wrote names the folder it was staged in
        grep -lI "$opt" "$opt"/bin/* "$opt/pyvenv.cfg" 2>/dev/null | while read -r file; do
            if [ ! -L "$file" ]; then
                sed -i "s|$opt|/opt/ertis|g" "$file"
            fi
        done
    fi
}

install_files() {
    install -D -m 644 -t "$units" daemon/systemd/ertis-daemon.service \
        daemon/systemd/ertis-daemon@.service
    install -D -m 644 udev/70-ertis.rules "$rule"
    install -D -m 644 -t "$opt/share/ertis" docs/install.md docs/security.md docs/ros2.md
    "$opt/bin/python" -m ertis_daemon.cli check-config >"$example"
    if [ -e "$config" ]; then
        echo "kept your ${config#"$root"}; the current example is ${example#"$root"}"
    else
        install -D -m 644 "$example" "$config"
    fi
    install -d "$(dirname "$link")"
    if [ -L "$link" ] || [ ! -e "$link" ]; then
        ln -sfn /opt/ertis/bin/ertis "$link"
    else
        echo "left ${link#"$root"} alone: it is not ours; the command is /opt/ertis/bin/ertis"
    fi
}

reload_system() {
    [ -z "$root" ] || return 0
    [ ! -d /run/systemd/system ] || systemctl daemon-reload
    if [ -e /run/udev/control ]; then
        udevadm control --reload
        udevadm trigger --subsystem-match=usb --subsystem-match=tty
    fi
}

remove_all() {
    [ -e "$opt/pyvenv.cfg" ] || fail "no installation in $opt"
    if [ -z "$root" ] && [ -d /run/systemd/system ]; then
        systemctl disable --quiet --now ertis-daemon.service 2>/dev/null || true
        systemctl stop 'ertis-daemon@*.service' 2>/dev/null || true
    fi
    if [ -e "$config" ] && cmp -s "$config" "$example"; then
        rm "$config"
    elif [ -e "$config" ]; then
        echo "kept ${config#"$root"}: you have changed it"
    fi
    rm -f "$units/ertis-daemon.service" "$units/ertis-daemon@.service" "$rule"
    [ "$(readlink "$link" || true)" != /opt/ertis/bin/ertis ] || rm "$link"
    rm -rf "$opt"
    # The folders that were made for it, where nothing else has moved in.
    if [ -d "$root/etc/ertis" ]; then
        rmdir --ignore-fail-on-non-empty "$root/etc/ertis"
    fi
    [ -z "$root" ] || (
        cd "$root"
        for folder in opt etc/ertis etc/systemd/system etc/udev/rules.d usr/local/bin; do
            [ ! -d "$folder" ] || rmdir -p --ignore-fail-on-non-empty "$folder"
        done
    )
}

case ${1:-} in
install)
    check_python
    check_place
    install_code
    install_files
    reload_system
    echo "installed; now edit ${config#"$root"}, then: systemctl enable --now ertis-daemon"
    ;;
uninstall)
    remove_all
    reload_system
    ;;
*) fail "usage: install.sh install | uninstall, by way of make" ;;
esac
