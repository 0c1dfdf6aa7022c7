#!/bin/bash
# Runs what a person would run on a fresh machine, in a bare Debian root: only python3, git and make are in it.
# Not part of make test (it takes minutes, root and the network); on Debian: apt install mmdebstrap systemd-container
#
#   tests/platform/bare_root.sh bookworm|trixie STEP...      WORK=/var/tmp/sagnode-roots  holds the roots
#
# ARCH=arm64 runs all of it as a Raspberry Pi's processor would, emulated (apt install qemu-user-static arch-test).
#
#   root       make the root anew
#   test       make test, twice (the second must find everything made)
#   demo       make demo, twice
#   rootless   make demo as a user without sudo and without python3-venv
#   deb        the package of "make deb": installed, a reading, upgraded, stepped back, removed, purged
#   install    deploy/install.sh, again (an upgrade), --uninstall, --uninstall --purge
#   picamera2  the picamera2 back end on the real Picamera2 and libcamera's virtual camera (trixie; +350 MB)
#   boot       the same root booted with systemd: the service is started, looked at, killed, updated, stopped; the machine
#              is restarted when no reading comes
#   boot-package   the same with the package, for ARCH=arm64: comes up by itself, measures, its worker killed, stopped
set -euo pipefail
HERE=$(cd "$(dirname "$0")/../.." && pwd)
WORK=${WORK:-/var/tmp/sagnode-roots}
suite=${1:-}
case $suite in bookworm | trixie) ;; *)
	sed -n '2,18s/^# \{0,1\}//p' "$0"
	exit 2
	;;
esac
shift
MACHINE=$(dpkg --print-architecture)
ARCH=${ARCH:-$MACHINE}
ROOT=$WORK/$suite
if [ "$ARCH" != "$MACHINE" ]; then
	ROOT=$ROOT-$ARCH
	# The core of the Pi 5: the default one, with every extension, is some twenty times slower on Debian 13.
	export QEMU_CPU=cortex-a76
	[ -e /proc/sys/fs/binfmt_misc/status ] || mount -t binfmt_misc none /proc/sys/fs/binfmt_misc
	[ -e /proc/sys/fs/binfmt_misc/qemu-aarch64 ] || update-binfmts --enable qemu-aarch64
fi
MIRROR=$(awk '/^URIs:/ {print $2; exit}' /etc/apt/sources.list.d/debian.sources 2>/dev/null || true)
MIRROR=${MIRROR:-http://deb.debian.org/debian}

make_root() {
	rm -rf --one-file-system "$ROOT" "$ROOT-systemd" "$ROOT-camera"
	mkdir -p "$WORK"
	mmdebstrap --quiet --variant=minbase --architectures="$ARCH" --aptopt='Acquire::Languages "none"' --include=python3,git,make,ca-certificates \
		--dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
		"$suite" "$ROOT" "deb $MIRROR $suite main" "deb $MIRROR-security $suite-security main"
	# pip brings its own certificates; a site with its own authority has them in the system's bundle.
	cp /etc/ssl/certs/ca-certificates.crt "$ROOT/etc/ssl/certs/"
	# Every installed machine has this; a root that was unpacked has not.
	printf '127.0.0.1 localhost\n::1 localhost\n' >"$ROOT/etc/hosts"
	du -sm "$ROOT"
}

# in_root COMMAND: as root, or with AS=user as a user; the network is the machine's.
in_root() {
	systemd-nspawn --quiet --directory="${IN:-$ROOT}" --register=no --keep-unit --console=pipe --resolv-conf=copy-host \
		--user="${AS:-root}" ${QEMU_CPU:+--setenv=QEMU_CPU="$QEMU_CPU"} --setenv=PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
		--setenv=SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt ${PIP_INDEX_URL:+--setenv=PIP_INDEX_URL} \
		bash -c "$1" </dev/null 2> >(grep -v 'Attempted to remove disk file system' >&2)
}

# A clone as a person has it: what is committed, and nothing else.
clone() {
	rm -rf --one-file-system "$ROOT/home/sagnode-clone"
	git clone --quiet "$HERE" "$ROOT/home/sagnode-clone"
	[ "${AS:-root}" = root ] || in_root_as_root "chown -R $AS: /home/sagnode-clone"
}
in_root_as_root() { AS=root in_root "$1"; }

timed() {
	local began
	began=$(date +%s)
	printf '=== %s: %s\n' "$suite" "$1"
	shift
	"$@"
	printf '=== took %s s\n\n' "$(($(date +%s) - began))"
}

make_booted_root() {
	[ -d "$ROOT-systemd" ] || {
		cp -a --reflink=auto "$ROOT" "$ROOT-systemd"
		IN=$ROOT-systemd in_root 'apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends systemd systemd-sysv dbus procps >/dev/null'
	}
}

boot() {
	make_booted_root
	rm -rf --one-file-system "$ROOT-systemd/home/sagnode-clone"
	git clone --quiet "$HERE" "$ROOT-systemd/home/sagnode-clone"
	IN=$ROOT-systemd in_root 'bash /home/sagnode-clone/deploy/install.sh --uninstall --purge && bash /home/sagnode-clone/deploy/install.sh'
	make_updates
	boot_with booted.sh >/dev/null || true
	cat "$ROOT-systemd/root/booted.log"
	grep -q '^BOOTED FINE' "$ROOT-systemd/root/booted.log"
	# systemd-nspawn ends with 133 when what runs in it asks for a restart.
	local said=0
	boot_with booted_reboot.sh ask || said=$?
	[ "$said" = 133 ] || {
		cat "$ROOT-systemd/root/booted.log"
		echo "FAIL  the machine ended with $said instead of a restart"
		return 1
	}
	boot_with booted_reboot.sh after || true
	cat "$ROOT-systemd/root/booted.log"
	grep -q '^REBOOT FINE' "$ROOT-systemd/root/booted.log"
}

# The package's service on another processor, with the demonstration's noon for a camera.
boot_package() {
	local package site
	package=$(find_package)
	make_booted_root
	rm -rf --one-file-system "$ROOT-systemd/packages"
	mkdir -p "$ROOT-systemd/packages"
	cp "$package" "$ROOT-systemd/packages/sagnode.deb"
	IN=$ROOT-systemd in_root 'export DEBIAN_FRONTEND=noninteractive
		! dpkg-query -W sagnode >/dev/null 2>&1 || apt-get purge -y -qq sagnode
		apt-get update -qq && apt-get install -y -qq --no-install-recommends /packages/sagnode.deb'
	site=$ROOT-systemd/etc/sagnode
	cp "$HERE"/src/sagnode/demo/site/{span.toml,camera.yaml,reference.jpg} "$site/"
	mkdir -p "$site/frames" "$ROOT-systemd/etc/systemd/system.conf.d" "$ROOT-systemd/etc/systemd/system/sagnode.service.d"
	cp "$HERE"/src/sagnode/demo/site/frames/20260621T1{1,2,3}*.jpg "$site/frames/"
	# Without the broker, and with an emulator's patience.
	sed '/^\[mqtt\]/,$d; s/^interval_s = .*/interval_s = 90\ndeadline_s = 85/' "$HERE/tests/platform/vm_node.toml" >"$site/node.toml"
	chmod -R a+rX "$site"
	printf '[Service]\nTimeoutStartSec=400\nWatchdogSec=400\nPrivateUsers=no\nPrivateIPC=no\n' \
		>"$ROOT-systemd/etc/systemd/system/sagnode.service.d/emulated.conf"
	printf '[Manager]\n%s\n' "${QEMU_CPU:+DefaultEnvironment=QEMU_CPU=$QEMU_CPU}" >"$ROOT-systemd/etc/systemd/system.conf.d/emulated.conf"
	LIMIT_S=1500 boot_with booted_arm.sh || true
	cat "$ROOT-systemd/root/booted.log"
	grep -q '^BOOTED FINE' "$ROOT-systemd/root/booted.log"
}

# boot_with SCRIPT [WORD...]: the root booted; a script of this directory runs in it and ends it. Its words: booted.log.
boot_with() {
	cp "$HERE/tests/platform/$1" "$ROOT-systemd/root/"
	rm -f "$ROOT-systemd/root/booted.log"
	cat >"$ROOT-systemd/etc/systemd/system/look.service" <<-U
		[Service]
		Type=oneshot
		ExecStart=/bin/sh -c 'bash /root/$* >/root/booted.log 2>&1; systemctl exit \$?'
	U
	SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1 timeout "${LIMIT_S:-900}" systemd-nspawn --quiet --directory="$ROOT-systemd" --boot \
		--register=no ${QEMU_CPU:+--setenv=QEMU_CPU="$QEMU_CPU"} --keep-unit --private-network --console=pipe systemd.wants=look.service </dev/null >"$ROOT-systemd.log" 2>&1
}

# The package of this suite and machine.
find_package() {
	local number=13 package
	[ "$suite" != bookworm ] || number=12
	package=$(find "$HERE/build" -name "sagnode_*+deb${number}_$ARCH.deb" 2>/dev/null | head -n 1)
	[ -f "$package" ] || {
		echo "no package for $suite $ARCH in $HERE/build: make deb" >&2
		return 1
	}
	printf '%s\n' "$package"
}

# changed_package FROM TO VERSION [FILE OF THE PROGRAM, SED WORDS]...: the same with another version and other contents.
changed_package() {
	local tree=$2.tree program
	dpkg-deb -R "$1" "$tree"
	sed -i "s/^Version: .*/Version: $3/" "$tree/DEBIAN/control"
	program=$(echo "$tree"/usr/lib/sagnode/venv/lib/python3.*/site-packages/sagnode)
	sed -i "s/^__version__ = .*/__version__ = \"${3%%+*}\"/" "$program/__init__.py"
	local to=$2
	shift 3
	while [ $# -gt 0 ]; do
		cp "$program/$1" "$program/$1.before"
		sed -i -E "$2" "$program/$1"
		! cmp -s "$program/$1" "$program/$1.before" || {
			echo "$1 was not changed by: $2" >&2
			return 1
		}
		rm "$program/$1.before"
		shift 2
	done
	dpkg-deb --root-owner-group -Znone -b "$tree" "$to" >/dev/null
	rm -rf --one-file-system "$tree"
}

# Releases to update to: one that runs, and three that must not stay.
make_updates() {
	local package to=$ROOT-systemd/packages ends='s/^def run\(args.*/&\n    raise SystemExit(1)/'
	package=$(find_package)
	rm -rf --one-file-system "$to"
	mkdir -p "$to"
	cp "$HERE/deploy/install.sh" "$to/"
	changed_package "$package" "$to/good.deb" 0.90.1+deb
	changed_package "$package" "$to/broken.deb" 0.90.2+deb cli/run.py "$ends"
	changed_package "$package" "$to/faulty.deb" 0.90.3+deb cli/doctor.py "$ends"
	changed_package "$package" "$to/later.deb" 0.90.4+deb daemon/node.py 's/^( *)notifier\.ready\(.*/\1raise SystemExit(1)/' \
		daemon/journal_file.py 's/^SCHEMA_VERSION = ([0-9]+)/&  + 1/; $ s/$/\n_MIGRATIONS[SCHEMA_VERSION - 1] = "CREATE TABLE later (x);"/'
}

# The package, and the same again with a higher version.
run_deb() {
	local package packages=$ROOT/packages
	package=$(find_package)
	rm -rf --one-file-system "$packages"
	mkdir -p "$packages"
	cp "$package" "$packages/sagnode.deb"
	changed_package "$package" "$packages/newer.deb" 99.0
	cp "$HERE/tests/platform/package.sh" "$packages/"
	in_root 'bash /packages/package.sh' | tee "$packages/log"
	grep -q '^PACKAGE FINE' "$packages/log"
}

run_picamera2() {
	[ "$suite" = trixie ] || {
		echo "libcamera in $suite is too old for the virtual camera"
		return 1
	}
	[ -d "$ROOT-camera" ] || {
		cp -a --reflink=auto "$ROOT" "$ROOT-camera"
		# python-prctl and the like, which picamera2 wants, are built from source.
		IN=$ROOT-camera in_root 'apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
			python3-libcamera libcamera-ipa gcc libc6-dev python3-dev libcap-dev python3-numpy python3-venv >/dev/null
			python3 -m venv --system-site-packages /opt/v
			/opt/v/bin/pip install --quiet picamera2 "opencv-python-headless>=4.13,<5" pydantic PyYAML'
	}
	rm -rf --one-file-system "$ROOT-camera/home/sagnode-clone"
	git clone --quiet "$HERE" "$ROOT-camera/home/sagnode-clone"
	IN=$ROOT-camera in_root 'cd /home/sagnode-clone && PYTHONPATH=src LIBCAMERA_LOG_LEVELS="*:FATAL" timeout 120 \
		/opt/v/bin/python tests/platform/picamera2_virtual.py'
}

for step in "$@"; do
	case $step in
	root) timed 'bare root' make_root ;;
	test)
		clone
		timed 'make test' in_root 'cd /home/sagnode-clone && make test'
		timed 'make test again' in_root 'cd /home/sagnode-clone && scripts/setup dev'
		;;
	demo)
		clone
		timed 'make demo' in_root 'cd /home/sagnode-clone && make demo'
		timed 'make demo again' in_root 'cd /home/sagnode-clone && make demo'
		;;
	rootless)
		in_root 'id builder >/dev/null 2>&1 || useradd --create-home builder; ! dpkg-query -W python3-venv 2>/dev/null | grep -q . || apt-get remove -y -qq "python3*-venv" >/dev/null'
		AS=builder clone
		AS=builder timed 'make demo without root' in_root 'cd /home/sagnode-clone && make demo'
		;;
	install)
		clone
		timed 'install' in_root 'bash /home/sagnode-clone/deploy/install.sh && sagnode --version && ls -l /etc/sagnode /opt/sagnode/releases && id sagnode'
		timed 'upgrade' in_root 'echo "# mine" >>/etc/sagnode/node.toml && bash /home/sagnode-clone/deploy/install.sh && tail -n 1 /etc/sagnode/node.toml && ls -l /opt/sagnode /opt/sagnode/releases'
		timed 'uninstall' in_root 'bash /home/sagnode-clone/deploy/install.sh --uninstall && ls /etc/sagnode && ! ls /opt/sagnode 2>/dev/null && ! command -v sagnode'
		timed 'purge' in_root 'bash /home/sagnode-clone/deploy/install.sh --uninstall --purge && ! ls -d /etc/sagnode /var/lib/sagnode 2>/dev/null && ! id sagnode 2>/dev/null'
		;;
	deb) timed "package on $suite $ARCH" run_deb ;;
	picamera2) timed 'picamera2 on a virtual camera' run_picamera2 ;;
	boot) timed 'booted with systemd' boot ;;
	boot-package) timed "the package's service on $ARCH" boot_package ;;
	*)
		echo "unknown step $step" >&2
		exit 2
		;;
	esac
done
