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
suite=${1:-}
case $suite in bookworm | trixie) ;; *)
	sed -n '2,18s/^# \{0,1\}//p' "$0"
	exit 2
	;;
esac
shift
. "$(dirname "$0")/roots.sh"

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

boot() {
	need_booted_root
	rm -rf --one-file-system "$ROOT-systemd/home/sagnode-clone"
	git clone --quiet "$HERE" "$ROOT-systemd/home/sagnode-clone"
	IN=$ROOT-systemd fetching in_root '! dpkg-query -W sagnode >/dev/null 2>&1 || apt-get purge -y -qq sagnode
		bash /home/sagnode-clone/deploy/install.sh --uninstall --purge && bash /home/sagnode-clone/deploy/install.sh'
	make_updates
	boot_with booted.sh || true
	was_fine BOOTED
	# systemd-nspawn ends with 133 when what runs in it asks for a restart.
	local said=0
	boot_with booted_reboot.sh ask || said=$?
	[ "$said" = 133 ] || {
		echo "FAIL  the machine ended with $said instead of a restart"
		return 1
	}
	boot_with booted_reboot.sh after || true
	was_fine REBOOT
}

# The package's service, with the demonstration's noon for a camera; then once more on a root that is read-only.
boot_package() {
	local package etc=$ROOT-systemd/etc interval="interval_s = 5\\ndeadline_s = 20"
	package=$(find_package)
	need_booted_root
	rm -rf --one-file-system "$ROOT-systemd/packages"
	mkdir -p "$ROOT-systemd/packages"
	cp "$package" "$ROOT-systemd/packages/sagnode.deb"
	[ ! -x "$ROOT-systemd/opt/sagnode/current/install.sh" ] || IN=$ROOT-systemd in_root 'bash /opt/sagnode/current/install.sh --uninstall --purge'
	IN=$ROOT-systemd fetching in_root 'export DEBIAN_FRONTEND=noninteractive
		! dpkg-query -W sagnode >/dev/null 2>&1 || apt-get purge -y -qq sagnode
		apt-get update -qq && apt-get install -y -qq --no-install-recommends /packages/sagnode.deb'
	rm -rf --one-file-system "$etc/systemd/system.conf.d" "$etc/systemd/system/sagnode.service.d"
	mkdir -p "$etc/systemd/system.conf.d" "$etc/systemd/system/sagnode.service.d"
	if [ -n "${QEMU_CPU:-}" ]; then
		# The emulator of programs is no kernel: it has no user and IPC namespaces to give, and takes filters of system
		# calls without applying them. It is slow, too.
		interval='interval_s = 90\ndeadline_s = 85'
		printf '[Service]\nTimeoutStartSec=400\nWatchdogSec=400\nPrivateUsers=no\nPrivateIPC=no\n' \
			>"$etc/systemd/system/sagnode.service.d/emulated.conf"
		printf '[Manager]\nDefaultEnvironment=QEMU_CPU=%s EMULATED=yes\n' "$QEMU_CPU" >"$etc/systemd/system.conf.d/emulated.conf"
	else
		printf '[Service]\nWatchdogSec=8\nRestartSec=1\n' >"$etc/systemd/system/sagnode.service.d/quick.conf"
	fi
	# Without the broker.
	sed "/^\[mqtt\]/,\$d; s/^interval_s = .*/$interval/" "$HERE/tests/platform/vm_node.toml" | write_site "$etc/sagnode"
	LIMIT_S=1500 boot_with booted_package.sh || true
	was_fine BOOTED
	[ -z "${QEMU_CPU:-}" ] || return 0
	local state=$ROOT-systemd.state
	rm -rf --one-file-system "$state"
	cp -a "$ROOT-systemd/var/lib/sagnode" "$state"
	NSPAWN="--read-only --bind=$state:/var/lib/sagnode" boot_with booted_readonly.sh || true
	was_fine READONLY
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
	cp "$HERE"/tests/platform/{package,looks}.sh "$packages/"
	fetching in_root 'bash /packages/package.sh' | tee "$packages/log"
	grep -q '^PACKAGE FINE' "$packages/log"
}

run_picamera2() {
	[ "$suite" = trixie ] || {
		echo "libcamera in $suite is too old for the virtual camera"
		return 1
	}
	# python-prctl and the like, which picamera2 wants, are built from source.
	copy_root camera 'apt-get update -qq
		DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
			python3-libcamera libcamera-ipa gcc libc6-dev python3-dev libcap-dev python3-numpy python3-venv >/dev/null
		python3 -m venv --system-site-packages /opt/v
		/opt/v/bin/pip install --quiet picamera2 "opencv-python-headless>=4.13,<5" pydantic PyYAML'
	rm -rf --one-file-system "$ROOT-camera/home/sagnode-clone"
	git clone --quiet "$HERE" "$ROOT-camera/home/sagnode-clone"
	IN=$ROOT-camera in_root 'cd /home/sagnode-clone && PYTHONPATH=src LIBCAMERA_LOG_LEVELS="*:FATAL" timeout 120 \
		/opt/v/bin/python tests/platform/picamera2_virtual.py'
}

lock_root
[ "${1:-}" = root ] || need_root
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
