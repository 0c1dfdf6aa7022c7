#!/bin/bash
# Installs sagnode from this checkout as a service, on Raspberry Pi OS or Debian 12 (Bookworm) or 13 (Trixie).
#
#   sudo deploy/install.sh               install, or upgrade and restart
#   deploy/install.sh --dry-run          say what would be done
#   sudo deploy/install.sh --uninstall   take the program and the service away; configuration and readings stay
#   sudo deploy/install.sh --uninstall --purge   those too, and the user
#
# The program goes to /opt/sagnode/releases/<version>/venv; /opt/sagnode/current points to the one in use and the one
# before it stays, so that a step back is: ln -sfn releases/<version> /opt/sagnode/current && systemctl restart sagnode.
# An existing configuration in /etc/sagnode is never touched. Works in a chroot or container without systemd running.
set -euo pipefail

HERE=$(cd "$(dirname "$0")/.." && pwd)
OPT=/opt/sagnode
ETC=/etc/sagnode
STATE=/var/lib/sagnode
COMMAND=/usr/local/bin/sagnode
UNIT=/etc/systemd/system/sagnode.service
NEEDED_MB=700

dry_run=no
action=install
purge=no

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
is_raspberry_pi() { grep -qs 'Raspberry Pi' /proc/device-tree/model; }
has_package() { dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed; }

usage() {
	sed -n '2,9s/^# \{0,1\}//p' "$0"
}

check_machine() {
	[ -r /etc/os-release ] || fail "no /etc/os-release: this is not Debian or Raspberry Pi OS"
	# shellcheck disable=SC1091
	. /etc/os-release
	codename=${VERSION_CODENAME:-unknown}
	constraints=$HERE/deploy/constraints-$codename.txt
	[ -f "$constraints" ] ||
		fail "${PRETTY_NAME:-this system} is not supported; Bookworm (12) and Trixie (13) are" \
			"upgrade the system, or install by hand: python3 -m venv, pip install ."
	case $(uname -m) in
	x86_64 | aarch64) ;;
	*) fail "$(uname -m): there are no OpenCV packages for it" "use the 64-bit Raspberry Pi OS" ;;
	esac
	[ "$dry_run" = yes ] || [ "$(id -u)" = 0 ] || fail "needs root" "sudo $0"
	local free_mb
	free_mb=$(df -Pm /opt 2>/dev/null | awk 'NR == 2 {print $4}')
	[ "${free_mb:-0}" -ge "$NEEDED_MB" ] || fail "/opt has ${free_mb:-no} MB free; $NEEDED_MB MB are needed"
	[ -f "$HERE/src/sagnode/__init__.py" ] || fail "$HERE is not a checkout of sagnode"
	version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' "$HERE/src/sagnode/__init__.py")
	[ -n "$version" ] || fail "no version in $HERE/src/sagnode/__init__.py"
	say "sagnode $version on ${PRETTY_NAME:-$codename}, $(uname -m)"
}

install_system_packages() {
	local wanted=(python3 python3-venv ca-certificates) missing=() package
	# Picamera2 is bound to the system's libcamera; it cannot come from PyPI.
	! is_raspberry_pi || wanted+=(python3-picamera2)
	for package in "${wanted[@]}"; do
		has_package "$package" || missing+=("$package")
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
}

# The release's own directory; a second installation of one version stands beside the first, since a virtual
# environment cannot be moved and the running one must not change under the daemon.
choose_release() {
	release=$OPT/releases/$version
	local n=2
	while [ -e "$release" ]; do
		release=$OPT/releases/$version-$n
		n=$((n + 1))
	done
}

build_release() {
	local site_packages=()
	if python3 -c 'import importlib.util as u, sys; sys.exit(u.find_spec("picamera2") is None)' 2>/dev/null; then
		say "picamera2 is installed: the environment sees the system's packages"
		site_packages=(--system-site-packages)
	fi
	say "building $release (some 250 MB from PyPI)"
	run mkdir -p "$release"
	# shellcheck disable=SC2064 # the value of now
	trap "[ '$dry_run' = yes ] || rm -rf '$release'" EXIT
	run python3 -m venv "${site_packages[@]}" "$release/venv"
	# A copy of what the package is made of: building must leave nothing of root's in the checkout.
	local source=$release/source
	run mkdir "$source"
	run cp -r "$HERE"/pyproject.toml "$HERE"/README.md "$HERE"/LICENSE "$HERE"/src "$source" ||
		fail "$HERE is not a whole checkout"
	run rm -rf "$source"/src/*.egg-info
	run "$release/venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-warn-script-location \
		--constraint "$constraints" "$source" || fail "pip could not install the packages (its words are above)" \
		"is the network up, and pypi.org or your mirror (PIP_INDEX_URL) reachable?"
	run rm -rf "$source"
	run cp "$HERE/README.md" "$HERE/LICENSE" "$release/"
	run "$release/venv/bin/python" -c 'import cv2, numpy, pydantic, paho.mqtt.client, apscheduler, sagnode' ||
		fail "the new environment does not work; nothing was changed but $release"
	[ "$dry_run" = yes ] || say "$("$release/venv/bin/sagnode" --version), $(du -sm "$release" | cut -f1) MB"
	trap - EXIT
}

switch_release() {
	previous=$(readlink "$OPT/current" || true)
	run ln -sfn "releases/${release##*/}" "$OPT/current.new"
	run mv -T "$OPT/current.new" "$OPT/current"
	run mkdir -p "$(dirname "$COMMAND")"
	run ln -sfn "$OPT/current/venv/bin/sagnode" "$COMMAND"
	local old
	for old in "$OPT"/releases/*; do
		[ -d "$old" ] || continue
		case releases/${old##*/} in
		"releases/${release##*/}" | "${previous:-none}") ;;
		*) run rm -rf "$old" ;;
		esac
	done
}

install_configuration() {
	configured=yes
	if [ ! -e "$ETC/node.toml" ] && [ ! -e "$ETC/span.toml" ]; then
		configured=no
		say "writing an example configuration to $ETC"
		run mkdir -p "$ETC"
		run "$COMMAND" config init --out "$ETC" >/dev/null || fail "no example configuration could be written to $ETC"
	elif ! run "$COMMAND" config check --config "$ETC" >/dev/null 2>&1; then
		configured=no
		say "WARNING: $ETC has faults; see: sagnode config check --config $ETC"
	fi
}

install_unit() {
	run mkdir -p "$(dirname "$UNIT")"
	run install -m 0644 "$HERE/systemd/sagnode.service" "$UNIT"
	for name in sagnode-reboot.path sagnode-reboot.service; do
		run install -m 0644 "$HERE/systemd/$name" "$(dirname "$UNIT")/$name"
	done
	if ! command -v systemctl >/dev/null 2>&1; then
		say "no systemd on this machine: the unit stands in $UNIT, nothing starts it"
		return
	fi
	run systemctl --quiet enable sagnode.service
	if ! systemd_runs; then
		say "systemd is not running here: the service starts with the next boot"
	elif [ "$configured" = yes ]; then
		run systemctl daemon-reload
		run systemctl restart sagnode.service || fail "the service does not start" "journalctl -u sagnode -n 50"
		say "the service runs: systemctl status sagnode"
	else
		run systemctl daemon-reload
	fi
}

uninstall() {
	[ "$dry_run" = yes ] || [ "$(id -u)" = 0 ] || fail "needs root" "sudo $0 --uninstall"
	if command -v systemctl >/dev/null 2>&1 && [ -e "$UNIT" ]; then
		! systemd_runs || run systemctl stop sagnode.service sagnode-reboot.path
		run systemctl --quiet disable sagnode.service
	fi
	run rm -rf "$UNIT" "$UNIT.d" "${UNIT%.service}-reboot.path" "${UNIT%.service}-reboot.service" "$OPT"
	[ ! -L "$COMMAND" ] || run rm -f "$COMMAND"
	! systemd_runs || run systemctl daemon-reload
	if [ "$purge" = yes ]; then
		run rm -rf "$ETC" "$STATE"
		! getent passwd sagnode >/dev/null || run userdel sagnode
		say "removed, with configuration, readings and user"
	else
		say "removed; left: $ETC, $STATE and the user sagnode (--uninstall --purge takes them too)"
	fi
}

while [ $# -gt 0 ]; do
	case $1 in
	--dry-run) dry_run=yes ;;
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

if [ "$action" = uninstall ]; then
	uninstall
	exit 0
fi
check_machine
install_system_packages
make_user
choose_release
build_release
switch_release
install_configuration
install_unit
if [ "$configured" = no ]; then
	say "next: describe your span in $ETC/node.toml and $ETC/span.toml, then"
	say "      sagnode config check --config $ETC && sudo systemctl restart sagnode"
fi
