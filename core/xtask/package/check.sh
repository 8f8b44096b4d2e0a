#!/bin/sh
# Installs PACKAGE.deb into a bare Debian below DIR and uses it as an unprivileged user: `cargo xtask package --check`.
# usage: unshare --mount sh -eu check.sh PACKAGE.deb DIR
set -eu
package=$1
dir=$2
root=$dir/chroot
screens=$dir/screens

step() { printf '\n== %s\n' "$*"; }
inside() { chroot "$root" /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive sh -euc "$1"; }
as_user() { inside "cd /home/surgeon; exec runuser -u surgeon -- env HOME=/home/surgeon sh -euc '$1'"; }
fail() { echo "FAILED: $*" >&2; exit 1; }

if [ ! -e "$root/etc/debian_version" ]; then
    step "a bare Debian"
    mkdir -p "$dir"
    debootstrap --variant=minbase bookworm "$root" >"$dir/debootstrap.log" 2>&1 || fail "debootstrap, see $dir/debootstrap.log"
fi
mount --make-rprivate /
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
cp /etc/resolv.conf "$root/etc/resolv.conf"
inside 'id surgeon >/dev/null 2>&1 || useradd --create-home surgeon; rm -rf /home/surgeon/*; rm -rf /home/surgeon/.local; dpkg --purge panoscope >/dev/null 2>&1 || true'

step "install"
cp "$package" "$root/tmp/panoscope.deb"
inside 'apt-get -qq update; apt-get -qq -y --no-install-recommends install xvfb xauth bash-completion man-db >/dev/null
        apt-get -qq -y install /tmp/panoscope.deb >/dev/null; dpkg --verify panoscope'
inside '! command -v cargo && ! command -v gcc' || fail "the chroot has a compiler, so it proves little"

step "run"
as_user 'panoscope --version; panoscope list >list.txt; grep -c . list.txt'
as_user 'panoscope run /usr/share/panoscope/graphs/surgeon.toml --headless --frames 60 | tail -n 4; ls -l out; test -s out/surgeon.mkv'
inside 'test ! -e /usr/share/panoscope/out' || fail "the run wrote into the installation"
step "doctor"
as_user 'panoscope doctor || test $? = 1'

step "manual pages and completion"
as_user 'for page in panoscope panoscope-run panoscope-editor panoscope-theatre; do man --warnings --encoding=UTF-8 --local-file /usr/share/man/man1/$page.1.gz 2>&1 >/dev/null | grep . && exit 1; done; true'
inside 'bash -ec ". /usr/share/bash-completion/bash_completion; _completion_loader panoscope || test \$? = 124; complete -p panoscope"'

step "windows"
show() { # window graph action
    as_user "xvfb-run -a -s \"-screen 0 1440x900x24\" panoscope-$1 /usr/share/panoscope/graphs/$2 --screenshot $1.png --after 25 $3"
    inside "test -s /home/surgeon/$1.png" || fail "no picture of the $1"
}
show editor depth.toml "--do save"
show theatre surgeon.toml ""
as_user 'ls depth depth/parts; panoscope check depth/depth.toml' || fail "the editor saved no copy"
mkdir -p "$screens"
cp "$root"/home/surgeon/*.png "$screens/"

step "upgrade"
rm -rf "$dir/newer"
dpkg-deb --raw-extract "$package" "$dir/newer"
sed -i 's/^Version: .*/&+1/' "$dir/newer/DEBIAN/control"
dpkg-deb --root-owner-group -Znone --build "$dir/newer" "$root/tmp/newer.deb" >/dev/null
rm -rf "$dir/newer"
inside 'apt-get -qq -y install /tmp/newer.deb >/dev/null; rm /tmp/newer.deb; dpkg-query --show panoscope; dpkg --verify panoscope'
as_user 'panoscope list | cmp - list.txt'

step "remove and purge"
# Removed without configuration files it is forgotten, and there is nothing left to purge.
inside 'apt-get -qq -y remove panoscope >/dev/null; dpkg --purge panoscope 2>/dev/null; rm /tmp/panoscope.deb'
left=$(inside 'find / -xdev -iname "*panoscope*" -not -path "/home/*" -not -path "/proc/*"')
[ -z "$left" ] || fail "purged, and yet there is: $left"
as_user 'test -s out/surgeon.mkv' || fail "removing the package took files of the user along"
printf '\nThe package passed.\n'
