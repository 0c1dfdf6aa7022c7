#!/bin/bash
# The smallest virtual machine in which this very checkout runs: Debian's kernel for this system, and as its root this
# machine's own files, read-only over 9p. Only one folder can be written, and one disk; tests/faults/guest.py starts it.
#
#   tests/platform/guest.sh      $WORK/guest/{kernel,initrd}: made where they are not there yet (70 MB of download)
#
# On Debian: apt install qemu-system-x86 busybox-static cpio
set -euo pipefail
. "$(dirname "$0")/initrd.sh"
WORK=${WORK:-/var/tmp/sagnode-roots}
GUEST=$WORK/guest
[ ! -f "$GUEST/kernel" ] || [ ! -f "$GUEST/initrd" ] || [ "$GUEST/initrd" -ot "$0" ] || exit 0

scratch=$(mktemp -d)
trap 'rm -rf --one-file-system "$scratch"' EXIT
chmod 755 "$scratch"
package=$(apt-cache depends linux-image-amd64 | awk '/Depends:/ {print $2; exit}')
[ -n "$package" ] || {
	echo 'apt knows no linux-image-amd64: apt-get update' >&2
	exit 1
}
(cd "$scratch" && apt-get download -qq "$package" 2>/dev/null && dpkg -x ./*.deb unpacked)
version=$(ls "$scratch/unpacked/lib/modules")
tree=$scratch/unpacked/lib/modules/$version
busybox depmod -b "$scratch/unpacked" "$version"
# A module's line names those it needs, the nearest first.
mapfile -t modules < <(for module in virtio_pci virtio_blk virtio_net 9pnet_virtio 9p crc32c_generic ext4; do
	grep -E "/$module\.ko" "$tree/modules.dep" | tr -d : | tr ' ' '\n' | tac
done | awk -v tree="$tree" '!seen[$0]++ {print tree "/" $0}')
mkdir -p "$GUEST"
make_initrd "$GUEST/initrd" "${modules[@]}" <<'I'
for m in /m/*.ko; do /bin/busybox insmod "$m" 2>/dev/null; done
for a in $(/bin/busybox cat /proc/cmdline); do case $a in share=*) S=${a#share=} ;; esac; done
t=trans=virtio,version=9p2000.L,msize=262144
/bin/busybox mount -t 9p -o "$t,cache=loose,ro" host /root
/bin/busybox mount -t proc proc /root/proc
/bin/busybox mount --move /dev /root/dev
/bin/busybox mount -t sysfs sys /root/sys
/bin/busybox mount -t tmpfs run /root/run
/bin/busybox mount -t 9p -o "$t,cache=none" share "/root$S"
/bin/busybox mount -t ext4 -o errors=remount-ro /root/dev/vda "/root$S/disk"
/bin/busybox ifconfig lo 127.0.0.1 up
/bin/busybox ifconfig eth0 10.0.2.15 netmask 255.255.255.0 up
exec /bin/busybox chroot /root /bin/sh "$S/job"
I
cp "$scratch/unpacked/boot/vmlinuz-$version" "$GUEST/kernel.part"
mv "$GUEST/kernel.part" "$GUEST/kernel"
