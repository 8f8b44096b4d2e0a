#!/bin/sh
# Installs WHEEL into an empty environment in a bare Debian below DIR and uses it there: `cargo xtask wheel --check`. Needs no network: WHEELS is a
# folder with what the wheel depends on.
# usage: unshare --mount sh -eu check_wheel.sh WHEEL WHEELS DIR SCRIPT FRAMES
set -eu
wheel=$1
wheels=$2
dir=$3
script=$4
frames=$5
root=$dir/chroot

inside() { chroot "$root" /usr/bin/env -i HOME=/home/user PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 sh -euc "cd /home/user; exec runuser -u user -- sh -euc '$1'"; }
fail() { echo "FAILED: $*" >&2; exit 1; }

if [ ! -e "$root/etc/debian_version" ]; then
    debootstrap --variant=minbase --include=python3,python3-venv bookworm "$root" >"$dir/debootstrap.log" 2>&1 || fail "debootstrap, see $dir/debootstrap.log"
fi
mount --make-rprivate /
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
chroot "$root" sh -euc 'id user >/dev/null 2>&1 || useradd --create-home user; rm -rf /home/user/* /tmp/wheels'
mkdir "$root/tmp/wheels"
cp "$wheel" "$wheels"/*.whl "$root/tmp/wheels/"
cp "$script" "$root/tmp/check_wheel.py"
chmod -R a+rX "$root/tmp/wheels" "$root/tmp/check_wheel.py"
inside 'python3 -m venv env; env/bin/pip install --quiet --no-index --find-links /tmp/wheels panoscope; env/bin/pip check'
inside "env/bin/python /tmp/check_wheel.py fingerprints.json $frames" || fail "the wheel does not work"
inside 'test "$(find . -path ./env -prune -o -path "./.*" -prune -o -type f -print | sort)" = ./fingerprints.json' || fail "graphs that are watched wrote files"
cp "$root/home/user/fingerprints.json" "$dir/fingerprints.json"
