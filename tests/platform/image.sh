#!/bin/bash
# Builds the root of the image's recipe (deploy/image) for a Raspberry Pi's processor, emulated: the layers and hooks of
# rpi-image-gen and our own, by the program that rpi-image-gen itself calls (bdebstrap), and looks at what came of it.
#
#   RPI_IMAGE_GEN=DIRECTORY tests/platform/image.sh      a checkout; without it, it is fetched
#
# Out of Debian's archive: what only Raspberry Pi's has (kernel, firmware, python3-picamera2) is left out, and with it
# partitions and boot. Needs the package (make deb) and, on Debian: apt install bdebstrap mmdebstrap rsync
# qemu-user-static arch-test systemd-container
set -euo pipefail
REVISION=262d4df
suite=trixie
ARCH=arm64
export suite ARCH
. "$(dirname "$0")/roots.sh"
. "$(dirname "$0")/looks.sh"
ROOT=$WORK/image
USER1=pi

find_recipe() {
	[ -z "${RPI_IMAGE_GEN:-}" ] || return 0
	RPI_IMAGE_GEN=$WORK/rpi-image-gen
	[ -d "$RPI_IMAGE_GEN" ] || timeout 300 git clone --quiet https://github.com/raspberrypi/rpi-image-gen "$RPI_IMAGE_GEN" ||
		skip "a checkout of rpi-image-gen (RPI_IMAGE_GEN=, revision $REVISION), which could not be fetched"
	git -C "$RPI_IMAGE_GEN" checkout --quiet "$REVISION"
}

build() {
	local source=$WORK/image.source words=() line
	rm -rf --one-file-system "$ROOT" "$source"
	mkdir -p "$source/packages" "$source/layers"
	cp "$(find_package)" "$source/packages/sagnode.deb"
	ssh-keygen -q -t ed25519 -N '' -C fleet -f "$source/key"
	while read -r line; do words+=("$line"); done < <(python3 "$HERE/tests/platform/image_layers.py" "$RPI_IMAGE_GEN" "$source/layers")
	[ ${#words[@]} -gt 20 ] || fail 'the layers were not resolved'
	(
		cd "$source"
		SOURCE_DATE_EPOCH=$(git -C "$HERE" log -1 --format=%ct)
		export SOURCE_DATE_EPOCH IGTOP=$RPI_IMAGE_GEN SRCROOT=$source LAYER_HOOKS=$RPI_IMAGE_GEN/layer-hooks \
			BDEBSTRAP_HOOKS=/usr/share/bdebstrap/hooks DEBIAN_FRONTEND=noninteractive
		PATH=$RPI_IMAGE_GEN/bin:$PATH
		# Roots's certificates are not wanted in an image; apt asks by plain HTTP and checks signatures.
		fetching bdebstrap --quiet --force --suite "$suite" --architectures "$ARCH" --variant minbase --mode root --format directory \
			--aptopt 'Acquire::Languages "none"' --mirrors "deb $MIRROR $suite main" --name sagnode --output "$source/out" --target "$ROOT" \
			"${words[@]}" --env PATH="$PATH" --env IGconf_ssh_pubkey_user1="$source/key.pub" \
			--customize-hook "'$RPI_IMAGE_GEN/scripts/bdebstrap/customize20-packages' \"\$1\""
	)
}

# has PATH WORDS
has() { grep -qF -- "$2" "$ROOT/$1" || fail "$1 does not say: $2"; }

look() {
	ok "$(in_root 'cd / && sagnode --version'), $(in_root 'uname -m'), $(du -sm --exclude=var/cache "$ROOT" | cut -f1) MB, $(in_root "dpkg-query -W -f '\n' | wc -l") packages"
	local unit
	for unit in sagnode ssh ssh-hostkeys-generate systemd-timesyncd systemd-networkd; do
		in_root "systemctl is-enabled --quiet $unit" || fail "$unit is not enabled"
	done
	! in_root 'systemctl is-enabled --quiet sagnode-update.timer' || fail 'updates are on without being asked for'
	ok 'enabled: the service, SSH, keys of its own at the first boot, time, network; updates are not'
	in_root 'id -nG sagnode' | grep -qw video || fail 'sagnode is not in the group video'
	[ "$(in_root 'stat -c "%U:%G %a" /etc/sagnode /etc/sagnode/node.toml /var/lib/sagnode' | tr '\n' ' ')" = \
		'root:sagnode 750 root:sagnode 640 sagnode:sagnode 750 ' ] || fail 'rights of the configuration or of the state'
	ok 'the user of the service may use cameras; configuration and state have their rights'
	# Asked of sudo and not tried: an emulated program gets no rights by its owner.
	in_root "sudo -l -U $USER1" | grep -q 'NOPASSWD: ALL' || fail "$USER1 cannot become root: the unit could not be set up"
	in_root "getent shadow root $USER1" | cut -d: -f2 | grep -vxE '[!*]+' && fail 'somebody has a password'
	cmp -s "$WORK/image.source/key.pub" "$ROOT/home/$USER1/.ssh/authorized_keys" || fail 'the key that may log in is not there'
	in_root 'mkdir -p /run/sshd && ssh-keygen -q -t ed25519 -N "" -f /tmp/key && sshd -T -h /tmp/key; rm /tmp/key*' >"$WORK/image.source/sshd"
	grep -qx 'passwordauthentication no' "$WORK/image.source/sshd" && grep -qx 'permitrootlogin no' "$WORK/image.source/sshd" ||
		fail 'SSH takes passwords, or root'
	ok "SSH by key only, and $USER1 may become root; nobody has a password"
	[ -z "$(find "$ROOT/etc/ssh" -name 'ssh_host_*')" ] || fail 'all units would have one host key'
	[ ! -s "$ROOT/etc/machine-id" ] || [ "$(cat "$ROOT/etc/machine-id")" = uninitialized ] || fail 'all units would have one machine-id'
	[ ! -e "$ROOT/etc/sagnode/tls" ] || fail 'a key of a unit is in it'
	! grep -rlE --exclude-dir=proc --exclude-dir=sys 'BEGIN [A-Z ]*PRIVATE KEY' "$ROOT"/{etc,home,root,var,opt,srv} || fail 'a private key is in it'
	[ -z "$(ls -A "$ROOT/var/lib/sagnode")" ] || fail 'readings are in it'
	in_root 'sagnode config check --config /etc/sagnode' >"$WORK/image.source/check" 2>&1 &&
		fail 'the configuration of no unit is taken for one'
	ok 'no private key, no host key, no machine-id, no readings; the example configuration is refused until it is filled in'
	has etc/systemd/journald.conf.d/sagnode.conf Storage=volatile
	has etc/systemd/system.conf.d/sagnode.conf RuntimeWatchdogSec=15s
	ok "the system's log is in memory, the hardware watchdog on"
}

lock_root
find_recipe
build
look
rm -rf --one-file-system "$ROOT" "$WORK/image.source"
echo 'IMAGE FINE'
