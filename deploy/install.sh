#!/bin/bash
# Installs sagnode as a service, on Raspberry Pi OS or Debian 12 (Bookworm) or 13 (Trixie).
#
#   sudo deploy/install.sh               from this checkout: install, or upgrade and restart
#   sudo deploy/install.sh --from FILE   from a package (make deb), without network or pip
#   sudo deploy/install.sh --rollback    back to the release before
#   deploy/install.sh --dry-run          say what would be done
#   sudo deploy/install.sh --uninstall   take the program and the service away; configuration and readings stay
#   sudo deploy/install.sh --uninstall --purge   those too, and the user
#
# A release is a directory of its own, /opt/sagnode/releases/<version>; /opt/sagnode/current points to the one in use and
# the one before it stays. A new one is looked over with its own doctor before anything is switched, and when the service
# does not become ready with it, or does not stay so for SETTLE_S seconds (20), the old one is put back by itself.
# An existing configuration in /etc/sagnode is never touched. Works in a chroot or container without systemd running.
# Where there is no checkout this script is /opt/sagnode/current/install.sh.
set -euo pipefail

# A service that calls this (sagnode-update) has directories of its own, which are not the daemon's.
unset STATE_DIRECTORY RUNTIME_DIRECTORY CONFIGURATION_DIRECTORY CREDENTIALS_DIRECTORY NOTIFY_SOCKET WATCHDOG_USEC

HERE=$(cd "$(dirname "$0")/.." && pwd)
SELF=$(readlink -f "$0")
OPT=/opt/sagnode
ETC=/etc/sagnode
STATE=/var/lib/sagnode
COMMAND=/usr/local/bin/sagnode
ENROL=/usr/local/sbin/sagnode-enrol
UNITS=/etc/systemd/system
NEEDED_MB=700
SETTLE_S=${SETTLE_S:-20}

dry_run=no
action=install
purge=no
package=
previous=
codename=
configured=no

say() { printf 'install: %s\n' "$*"; }
fail() {
	printf 'install: error: %s\n' "$1" >&2
	[ $# -lt 2 ] || printf '         %s\n' "${@:2}" >&2
	exit 1
}
# Everything that changes the machine goes through here.
run() {
	if [ "$dry_run" = yes ]; then
		printf '+ %s\n' "$*"
	else
		"$@"
	fi
}

systemd_runs() { [ -d /run/systemd/system ]; }
has_systemd() { command -v systemctl >/dev/null 2>&1; }
is_raspberry_pi() { grep -qs 'Raspberry Pi' /proc/device-tree/model; }
has_package() { dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed; }
needs_root() { [ "$dry_run" = yes ] || [ "$(id -u)" = 0 ] || fail "needs root" "sudo $0 $*"; }

usage() {
	sed -n '2,10s/^# \{0,1\}//p' "$0"
}

check_machine() {
	[ -r /etc/os-release ] || fail "no /etc/os-release: this is not Debian or Raspberry Pi OS"
	# shellcheck disable=SC1091
	. /etc/os-release
	codename=${VERSION_CODENAME:-unknown}
	case $codename in
	bookworm | trixie) ;;
	*)
		fail "${PRETTY_NAME:-this system} is not supported; Bookworm (12) and Trixie (13) are" \
			"upgrade the system, or install by hand: python3 -m venv, pip install ."
		;;
	esac
	case $(uname -m) in
	x86_64 | aarch64) ;;
	*) fail "$(uname -m): there are no OpenCV packages for it" "use the 64-bit Raspberry Pi OS" ;;
	esac
	needs_root
	! has_package sagnode || fail "the Debian package sagnode is installed" \
		"upgrade that: apt install ./sagnode_....deb; or apt remove sagnode first"
	local free_mb
	free_mb=$(df -Pm /opt 2>/dev/null | awk 'NR == 2 {print $4}')
	[ "${free_mb:-0}" -ge "$NEEDED_MB" ] || fail "/opt has ${free_mb:-no} MB free; $NEEDED_MB MB are needed"
	if [ -n "$package" ]; then
		check_package
	else
		[ -f "$HERE/src/sagnode/__init__.py" ] || fail "$HERE is not a checkout of sagnode" "$0 --from PACKAGE needs none"
		version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' "$HERE/src/sagnode/__init__.py")
		[ -n "$version" ] || fail "no version in $HERE/src/sagnode/__init__.py"
	fi
	say "sagnode $version on ${PRETTY_NAME:-$codename}, $(uname -m)"
}

check_package() {
	[ -f "$package" ] || fail "no file $package"
	[ "$(dpkg-deb -f "$package" Package 2>/dev/null)" = sagnode ] || fail "$package is not a package of sagnode"
	local arch
	arch=$(dpkg-deb -f "$package" Architecture)
	[ "$arch" = "$(dpkg --print-architecture)" ] ||
		fail "$package is for $arch, this machine is $(dpkg --print-architecture)"
	version=$(dpkg-deb -f "$package" Version)
	version=${version%%+deb*}
}

install_system_packages() {
	local wanted=(python3 ca-certificates) missing=() name
	if [ -z "$package" ]; then
		wanted+=(python3-venv)
		# Where there is a compiler, as on Raspberry Pi OS, all that it lacks for the compiled kernels.
		! command -v gcc >/dev/null || wanted+=(python3-dev)
	fi
	# Picamera2 is bound to the system's libcamera; it cannot come from PyPI.
	! is_raspberry_pi || wanted+=(python3-picamera2)
	for name in "${wanted[@]}"; do
		has_package "$name" || missing+=("$name")
	done
	if [ ${#missing[@]} -gt 0 ]; then
		say "installing ${missing[*]} with apt"
		run env DEBIAN_FRONTEND=noninteractive apt-get update -qq || fail "apt-get update failed" "is the network up?"
		run env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null ||
			fail "apt could not install ${missing[*]}"
	fi
}

make_user() {
	if ! getent passwd sagnode >/dev/null; then
		say "making the user sagnode"
		run useradd --system --user-group --home-dir "$STATE" --no-create-home --shell /usr/sbin/nologin sagnode
	fi
	getent group video >/dev/null || run groupadd --system video
	run usermod --append --groups video sagnode
	# As the unit's StateDirectory= would make it at the first start; until then doctor and status have where to look.
	[ -d "$STATE" ] || run install -d -m 0750 -o sagnode -g sagnode "$STATE"
}

# The release's own directory; a second installation of one version stands beside the first, since the running one must
# not change under the daemon.
choose_release() {
	release=$OPT/releases/$version
	local n=2
	while [ -e "$release" ]; do
		release=$OPT/releases/$version-$n
		n=$((n + 1))
	done
	previous=$(readlink "$OPT/current" || true)
}

build_release() {
	run mkdir -p "$release"
	# shellcheck disable=SC2064 # the value of now
	trap "[ '$dry_run' = yes ] || rm -rf '$release'" EXIT
	if [ -n "$package" ]; then
		unpack_release
	else
		pip_release
	fi
	# For the step back and for updates, where there is no checkout.
	run cp "$SELF" "$release/install.sh"
	run "$release/venv/bin/python" -c 'import cv2, numpy, pydantic, paho.mqtt.client, apscheduler, sagnode' ||
		fail "the new release does not work on this machine; nothing was changed"
	run "$release/venv/bin/python" -c 'import sys; from sagnode.native import why_not; sys.exit(why_not or 0)' || {
		say "WARNING: sagnode works without its compiled kernels here (why is above): a frame takes longer"
		say "         to have them: --from PACKAGE, or apt install gcc libc6-dev python3-dev and this again"
	}
	# The service may not write here, so that its imports would be compiled anew at every start.
	run "$release/venv/bin/python" -m compileall -q -j 0 "$release/venv/lib" || say "some modules could not be compiled"
	[ "$dry_run" = yes ] || say "$("$release/venv/bin/sagnode" --version), $(du -sm "$release" | cut -f1) MB"
}

unpack_release() {
	say "unpacking $package to $release"
	run dpkg-deb -x "$package" "$release/unpacked"
	run mv "$release/unpacked/usr/lib/sagnode/venv" "$release/venv"
	run mkdir "$release/systemd"
	run find "$release/unpacked" -path '*/systemd/system/*' -type f -exec cp {} "$release/systemd/" \;
	run sed -i "s,/usr/bin/sagnode,$COMMAND," "$release/systemd/sagnode.service"
	run cp "$release/unpacked/usr/share/doc/sagnode/README.md" "$release/"
	run cp "$release/unpacked/usr/sbin/sagnode-enrol" "$release/unpacked/usr/lib/sagnode/update.py" "$release/"
	run rm -rf "$release/unpacked"
}

pip_release() {
	local site_packages=()
	if python3 -c 'import importlib.util as u, sys; sys.exit(u.find_spec("picamera2") is None)' 2>/dev/null; then
		say "picamera2 is installed: the environment sees the system's packages"
		site_packages=(--system-site-packages)
	fi
	say "building $release (some 250 MB from PyPI)"
	run python3 -m venv "${site_packages[@]}" "$release/venv"
	# A copy of what the package is made of: building must leave nothing of root's in the checkout.
	local source=$release/source
	run mkdir "$source"
	run cp -r "$HERE"/pyproject.toml "$HERE"/README.md "$HERE"/LICENSE "$HERE"/src "$source" ||
		fail "$HERE is not a whole checkout"
	run rm -rf "$source"/src/*.egg-info "$source"/src/sagnode/native/*.so
	# Wheels only, and only those whose hashes are in the lock: nothing of others is compiled, and nothing else comes in.
	local pip=("$release/venv/bin/python" -m pip)
	local install=("${pip[@]}" install --quiet --disable-pip-version-check --no-warn-script-location)
	run "${install[@]}" --only-binary=:all: --require-hashes --requirement "$HERE/deploy/requirements-$codename.txt" ||
		fail "pip could not install the packages (its words are above)" \
			"is the network up, and pypi.org or your mirror (PIP_INDEX_URL) reachable?"
	run "${install[@]}" --no-deps --no-build-isolation "$source" || fail "pip could not install sagnode itself"
	run "${pip[@]}" uninstall --quiet --yes setuptools packaging
	run rm -rf "$source"
	run cp -r "$HERE/systemd" "$release/systemd"
	run cp "$HERE/README.md" "$HERE/LICENSE" "$HERE/deploy/certificates/sagnode-enrol" "$HERE/deploy/update.py" "$release/"
}

# Looks with the new release at what the old one works with; nothing has been switched yet.
preflight() {
	if [ ! -e "$ETC/node.toml" ] && [ ! -e "$ETC/span.toml" ]; then
		say "writing an example configuration to $ETC"
		[ -d "$ETC" ] || run install -d -m 0750 -o root -g sagnode "$ETC"
		run "$release/venv/bin/sagnode" config init --out "$ETC" >/dev/null ||
			fail "no example configuration could be written to $ETC"
		run chown root:sagnode "$ETC/node.toml" "$ETC/span.toml"
		run chmod 0640 "$ETC/node.toml" "$ETC/span.toml"
	elif [ "$dry_run" = yes ]; then
		run "$release/venv/bin/sagnode" doctor --config "$ETC" --skip camera --skip broker --skip system
		configured=yes
	elif look_over "$release"; then
		configured=yes
	elif [ -n "$previous" ] && look_over "$OPT/$previous"; then
		"$release/venv/bin/sagnode" doctor --config "$ETC" --skip camera --skip broker --skip system >&2 || true
		fail "the new release finds faults that the one in use does not (above); nothing was changed"
	else
		say "WARNING: $ETC has faults; see: sagnode doctor"
		# A daemon that runs all the same must not go on out of a release that will be taken away.
		! systemd_runs || ! systemctl is-active --quiet sagnode.service || configured=yes
	fi
}
look_over() {
	"$1/venv/bin/sagnode" doctor --config "$ETC" --skip camera --skip broker --skip system >/dev/null 2>&1
}

# point_to RELEASE: the link, the command and the units.
point_to() {
	run ln -sfn "$1" "$OPT/current.new"
	run mv -T "$OPT/current.new" "$OPT/current"
	run mkdir -p "$(dirname "$COMMAND")" "$(dirname "$ENROL")" "$UNITS"
	run ln -sfn "$OPT/current/venv/bin/sagnode" "$COMMAND"
	run ln -sfn "$OPT/current/sagnode-enrol" "$ENROL"
	if [ "$dry_run" = yes ]; then
		run install -m 0644 "$OPT/current/systemd/sagnode.service" "$UNITS/sagnode.service"
	else
		install -m 0644 "$OPT"/current/systemd/sagnode* "$UNITS/"
	fi
	# A power cut must find the old release or the new one.
	run sync -f "$OPT"
	! systemd_runs || run systemctl daemon-reload
}

schema() { "$1/venv/bin/python" -c 'from sagnode.daemon.journal_file import SCHEMA_VERSION; print(SCHEMA_VERSION)'; }
journal_files() { find "$STATE" -maxdepth 1 -name 'journal.sqlite*'; }

# An old release does not read the journal of a later one: keep it as it was, until the new release has proved itself.
keep_journal() {
	journal_kept=
	[ -n "$previous" ] && [ "$dry_run" = no ] || return 0
	[ "$(schema "$release")" != "$(schema "$OPT/$previous")" ] || return 0
	journal_kept=$STATE/journal-before-$version
	say "the new release changes the journal's form: keeping a copy"
	! systemd_runs || systemctl stop sagnode.service
	rm -rf "$journal_kept"
	install -d -m 0750 -o sagnode -g sagnode "$journal_kept"
	journal_files | xargs -r cp -a --target-directory="$journal_kept"
}

put_journal_back() {
	[ -n "$journal_kept" ] || return 0
	systemctl stop sagnode.service || true
	local aside
	aside=$STATE/journal-of-$version-$(date -u +%Y%m%dT%H%M%SZ)
	install -d -m 0750 -o sagnode -g sagnode "$aside"
	journal_files | xargs -r mv --target-directory="$aside"
	find "$journal_kept" -type f -exec mv --target-directory="$STATE" {} +
	rmdir "$journal_kept"
	say "the journal is as it was before; what the new release wrote is in $aside"
}

# Ready is what the service says of itself; staying so is what it shows.
start() {
	systemctl reset-failed sagnode.service 2>/dev/null || true
	systemctl restart sagnode.service || return 1
	local pid waited
	pid=$(systemctl show --value -p MainPID sagnode.service)
	for ((waited = 0; waited < SETTLE_S; waited++)); do
		sleep 1
		systemctl is-active --quiet sagnode.service || return 1
		[ "$(systemctl show --value -p MainPID sagnode.service)" = "$pid" ] || return 1
	done
}

start_or_go_back() {
	if ! has_systemd; then
		say "no systemd on this machine: the unit stands in $UNITS, nothing starts it"
		return
	fi
	run systemctl --quiet enable sagnode.service
	if ! systemd_runs; then
		say "systemd is not running here: the service starts with the next boot"
	elif [ "$configured" = yes ] && [ "$dry_run" = yes ]; then
		run systemctl restart sagnode.service
	elif [ "$configured" = yes ]; then
		if start; then
			say "the service runs: systemctl status sagnode"
		else
			journalctl --no-pager -o cat -u sagnode.service -n 10 >&2 || true
			go_back
		fi
	fi
}

go_back() {
	[ -n "$previous" ] || fail "the service does not start" "journalctl -u sagnode -n 50"
	say "sagnode $version does not run (its words are above): putting ${previous#releases/} back"
	systemctl stop sagnode.service || true
	point_to "$previous"
	put_journal_back
	rm -rf "$release"
	start || fail "${previous#releases/} is back, and does not run either" "journalctl -u sagnode -n 50"
	fail "sagnode $version was not installed; ${previous#releases/} runs as before"
}

forget_old_releases() {
	[ -z "${journal_kept:-}" ] || run rm -rf "$journal_kept"
	local old
	for old in "$OPT"/releases/*; do
		[ -d "$old" ] || continue
		case releases/${old##*/} in
		"releases/${release##*/}" | "${previous:-none}") ;;
		*) run rm -rf "$old" ;;
		esac
	done
}

rollback() {
	needs_root --rollback
	previous=$(readlink "$OPT/current" || true)
	[ -n "$previous" ] || fail "nothing is installed in $OPT"
	local other
	other=$(find "$OPT/releases" -mindepth 1 -maxdepth 1 -type d ! -name "${previous##*/}" | head -n 1)
	[ -n "$other" ] || fail "there is no release beside ${previous#releases/}"
	release=$other version=${other##*/} journal_kept=
	look_over "$release" || {
		"$release/venv/bin/sagnode" doctor --config "$ETC" --skip camera --skip broker --skip system >&2 || true
		fail "$version cannot work with what is here (above); nothing was changed"
	}
	configured=yes
	point_to "releases/${release##*/}"
	start_or_go_back
	say "back to $version"
}

uninstall() {
	local link unit
	needs_root --uninstall
	for unit in sagnode-update.timer sagnode.service sagnode-reboot.path; do
		if has_systemd && [ -e "$UNITS/$unit" ]; then
			! systemd_runs || run systemctl stop "$unit"
			run systemctl --quiet disable "$unit"
		fi
	done
	run rm -rf "$UNITS"/sagnode.service "$UNITS"/sagnode-reboot.{path,service} "$UNITS"/sagnode-update.{timer,service} \
		"$UNITS"/sagnode.service.d "$OPT"
	for link in "$COMMAND" "$ENROL"; do
		[ ! -L "$link" ] || run rm -f "$link"
	done
	! systemd_runs || run systemctl daemon-reload
	if [ "$purge" = yes ]; then
		run rm -rf "$ETC" "$STATE" "$STATE-update"
		! getent passwd sagnode >/dev/null || run userdel sagnode
		say "removed, with configuration, readings and user"
	else
		say "removed; left: $ETC, $STATE and the user sagnode (--uninstall --purge takes them too)"
	fi
}

while [ $# -gt 0 ]; do
	case $1 in
	--dry-run) dry_run=yes ;;
	--from)
		[ $# -gt 1 ] || fail "--from needs a package"
		package=$2
		shift
		;;
	--rollback) action=rollback ;;
	--uninstall) action=uninstall ;;
	--purge) purge=yes ;;
	-h | --help)
		usage
		exit 0
		;;
	*)
		usage >&2
		exit 2
		;;
	esac
	shift
done
[ "$purge" = no ] || [ "$action" = uninstall ] || fail "--purge goes with --uninstall"

if [ "$action" != install ]; then
	"$action"
	exit 0
fi
check_machine
install_system_packages
make_user
choose_release
build_release
preflight
trap - EXIT
keep_journal
point_to "releases/${release##*/}"
start_or_go_back
forget_old_releases
if [ "$configured" = no ]; then
	say "next: describe your span in $ETC/node.toml and $ETC/span.toml, then"
	say "      sudo sagnode doctor && sudo systemctl restart sagnode"
fi
