#!/bin/bash
# A virtual machine with Debian 13's own kernel, for what a container cannot have: /dev/video* from the kernel's vivid and
# v4l2loopback drivers, a hardware watchdog, a cold boot. Software emulation (no KVM needed): slow, and right.
#
#   tests/platform/vm.sh root            $WORK/trixie-vm: the bare root with a kernel, v4l2loopback and a broker
#   tests/platform/vm.sh image           the package installed in it and configured, and all of it as a disk
#   tests/platform/vm.sh run JOB...      boots a throw-away copy; runs each script of tests/platform in it, as root
#
# Needs bare_root.sh trixie root, the package for trixie on amd64 (make deb) and, on Debian: apt install qemu-system-x86
# systemd-container busybox-static cpio e2fsprogs
set -euo pipefail
export suite=trixie ARCH=amd64
. "$(dirname "$0")/roots.sh"
. "$(dirname "$0")/initrd.sh"
BARE=$ROOT
ROOT=$WORK/trixie-vm
DISK=$WORK/vm.ext4
KERNEL=$WORK/vm-kernel
INITRD=$WORK/vm-initrd
LIMIT_S=${LIMIT_S:-1800}
export BIND=$HERE:/checkout

make_machine_root() {
	[ -d "$BARE" ] || {
		echo "no $BARE: tests/platform/bare_root.sh trixie root" >&2
		exit 1
	}
	rm -rf --one-file-system "$ROOT" "$ROOT.new"
	flock "$BARE.lock" cp -a --reflink=auto "$BARE" "$ROOT.new"
	# v4l2loopback is built for the kernel that is installed beside it; its compiler goes away again.
	IN=$ROOT.new fetching in_root 'export DEBIAN_FRONTEND=noninteractive
		apt-get update -qq
		apt-get install -y -qq --no-install-recommends systemd systemd-sysv dbus udev kmod procps iproute2 v4l-utils mosquitto \
			mosquitto-clients linux-image-amd64 linux-headers-amd64 v4l2loopback-dkms >/dev/null
		dkms status
		mkdir -p /root/kept && cp -a /lib/modules/*/updates /root/kept/
		apt-get purge -y -qq v4l2loopback-dkms dkms linux-headers-amd64 >/dev/null
		apt-get autoremove -y -qq --purge >/dev/null
		cp -a /root/kept/updates /lib/modules/*/ && rm -r /root/kept
		depmod "$(ls /lib/modules)"
		modinfo -k "$(ls /lib/modules)" -F version v4l2loopback
		apt-get clean; rm -rf /var/lib/apt/lists/*
		systemctl mask --quiet getty@.service serial-getty@.service systemd-logind.service apt-daily.timer \
			apt-daily-upgrade.timer fstrim.timer dpkg-db-backup.timer e2scrub_all.timer'
	: >"$ROOT.new/etc/fstab"
	mv "$ROOT.new" "$ROOT"
	du -sm "$ROOT"
}

# The package, and a configuration that measures from the first moment on and delivers to the broker beside it.
install_package() {
	local package
	package=$(find_package)
	in_root "! dpkg-query -W sagnode >/dev/null 2>&1 || apt-get purge -y -qq sagnode
		dpkg -i /checkout/build/${package##*/}
		systemctl --quiet enable mosquitto"
	write_site "$ROOT/etc/sagnode" <"$HERE/tests/platform/vm_node.toml"
	printf 'i6300esb\n' >"$ROOT/etc/modules-load.d/watchdog.conf"
	mkdir -p "$ROOT/etc/systemd/system.conf.d"
	printf '[Manager]\nRuntimeWatchdogSec=30\n' >"$ROOT/etc/systemd/system.conf.d/watchdog.conf"
}

make_job() {
	cat >"$ROOT/etc/systemd/system/job.service" <<-'U'
		[Unit]
		Description=Jobs of tests/platform/vm.sh
		[Service]
		ExecStart=/bin/bash /usr/local/sbin/job
	U
	cat >"$ROOT/usr/local/sbin/job" <<-'J'
		mkdir -p /mnt
		modprobe -a 9p 9pnet_virtio
		mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,cache=loose share /mnt
		exec >/mnt/out.log 2>&1
		ip link set lo up
		rc=0
		while read -r job; do
			echo "=== $job, up $(cut -d' ' -f1 /proc/uptime) s"
			case $job in *.py) /usr/lib/sagnode/venv/bin/python "/mnt/platform/$job" ;; *) bash "/mnt/platform/$job" ;; esac || rc=1
			echo "=== $job over, up $(cut -d' ' -f1 /proc/uptime) s"
		done </mnt/jobs
		echo "JOBS RC $rc"
		sync
		systemctl poweroff -ff
	J
}

make_image() {
	install_package
	make_job
	local kernel_version
	kernel_version=$(ls "$ROOT/usr/lib/modules")
	mapfile -t modules < <(in_root "modprobe -S $kernel_version --show-depends -a virtio_blk virtio_pci ext4" |
		awk -v root="$ROOT" '/^insmod/ && !seen[$2]++ {print root $2}')
	make_initrd "$INITRD" "${modules[@]}" <<-'I'
		while [ ! -b /dev/vda ]; do /bin/busybox sleep 0.1; done
		/bin/busybox mount -t ext4 /dev/vda /root
		/bin/busybox mount --move /dev /root/dev
		/bin/busybox umount /proc
		exec /bin/busybox switch_root /root /lib/systemd/systemd
	I
	cp "$ROOT"/boot/vmlinuz-* "$KERNEL"
	# As if made just now: without this systemd rebuilds its caches at the first boot of every throw-away copy.
	printf 'x\nTIMESTAMP_NSEC=%s000000000\n' "$(($(date +%s) + 60))" | tee "$ROOT/etc/.updated" >"$ROOT/var/.updated"
	rm -f "$DISK"
	mke2fs -q -F -t ext4 -d "$ROOT" "$DISK" 5G
	ls -l --block-size=M "$DISK" "$INITRD" "$KERNEL"
}

# Its clock counts instructions, one a nanosecond, so that no other work on this machine makes it seem slow: one core that
# does 1000 million instructions a second, which is less than one of a Raspberry Pi 4 does.
boot_machine() {
	timeout "$LIMIT_S" qemu-system-x86_64 -accel tcg,thread=single,tb-size=512 -icount shift=0,sleep=on \
		-cpu Nehalem -M q35 -m 2048 -smp 1 -nographic -no-reboot -nodefaults -serial stdio \
		-kernel "$KERNEL" -initrd "$INITRD" \
		-append 'console=ttyS0 quiet panic=-1 mitigations=off rw systemd.wants=job.service' \
		-drive "file=$DISK,format=raw,if=virtio,cache=unsafe,snapshot=on" -device i6300esb -watchdog-action reset \
		-virtfs "local,path=$1,mount_tag=share,security_model=none" </dev/null >"$WORK/vm.log" 2>&1 || true
}

run_jobs() {
	local share=$WORK/vm-share began try
	[ -f "$DISK" ] || {
		echo "no $DISK: tests/platform/vm.sh root image" >&2
		exit 1
	}
	rm -rf --one-file-system "$share"
	mkdir -p "$share/platform"
	cp -r "$HERE"/tests/platform/. "$share/platform/"
	cp -r "$HERE/src/sagnode/demo/site" "$share/site"
	printf '%s\n' "$@" >"$share/jobs"
	began=$(date +%s)
	# The emulator at times breaks a kernel in its first second (seen with QEMU 7.2: "text_poke_early"), before anything of
	# ours has run; only then is it tried again.
	for try in 1 2 3; do
		boot_machine "$share"
		[ ! -e "$share/out.log" ] || break
		echo "try $try: the virtual machine did not come up; its last words:"
		grep -aE 'panic|RIP|BUG' "$WORK/vm.log" | tail -n 3 || true
	done
	cat "$share/out.log" || tail -n 40 "$WORK/vm.log"
	printf 'virtual machine: %s s in all\n' "$(($(date +%s) - began))"
	grep -q '^JOBS RC 0' "$share/out.log"
}

case ${1:-} in root | image | run) lock_root ;; esac
case ${1:-} in
root) make_machine_root ;;
image) make_image ;;
run)
	shift
	run_jobs "$@"
	;;
*)
	sed -n '2,11s/^# \{0,1\}//p' "$0"
	exit 2
	;;
esac
