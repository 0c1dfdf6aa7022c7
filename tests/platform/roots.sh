#!/bin/bash
# Debian roots, and machines that are booted from them: what bare_root.sh, image.sh and vm.sh have in common.
#
# Wants $suite; sets HERE, WORK, ARCH, ROOT. A root has a lock of its own, $ROOT.lock: whoever uses it holds that, so that
# two clones, or two lanes, wait for each other instead of meeting in it.
HERE=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
WORK=${WORK:-/var/tmp/sagnode-roots}
MACHINE=$(dpkg --print-architecture)
ARCH=${ARCH:-$MACHINE}
ROOT=$WORK/${suite:?}
MIRROR=$(awk '/^URIs:/ {print $2; exit}' /etc/apt/sources.list.d/debian.sources 2>/dev/null || true)
MIRROR=${MIRROR:-http://deb.debian.org/debian}
CERTIFICATES=/etc/ssl/certs/ca-certificates.crt
if [ "$ARCH" != "$MACHINE" ]; then
	ROOT=$ROOT-$ARCH
	# The core of the Pi 5: the default one, with every extension, is some twenty times slower on Debian 13.
	export QEMU_CPU=cortex-a76
	[ -e /proc/sys/fs/binfmt_misc/status ] || mount -t binfmt_misc none /proc/sys/fs/binfmt_misc
	[ -e /proc/sys/fs/binfmt_misc/qemu-aarch64 ] || update-binfmts --enable qemu-aarch64
fi

# Ends the script as lanes.py wants it where this machine cannot show something.
skip() {
	printf 'skipped: needs %s\n' "$1"
	exit 77
}

# fetching COMMAND...: one that asks Debian's mirror or PyPI, and fails as "skipped" when it cannot reach them.
fetching() {
	local log said=0 line
	log=$(mktemp)
	"$@" 2>&1 | tee "$log" || said=$?
	line=$(grep -m1 -E 'apt-get update .* failed|Could not resolve|Temporary failure|Failed to fetch|Unable to connect|Connection (refused|timed out|failed)|Max retries|No matching distribution' "$log" || true)
	rm -f "$log"
	[ $said = 0 ] || [ -z "$line" ] || skip "the network: ${line:0:160}"
	return $said
}

lock_root() {
	mkdir -p "$WORK"
	exec 9>"$ROOT.lock"
	flock 9
}

# A root is made beside its place and then moved there: one that was interrupted is not taken for a whole one.
make_root() {
	rm -rf --one-file-system "$ROOT" "$ROOT".new "$ROOT-systemd" "$ROOT-camera"
	fetching mmdebstrap --quiet --variant=minbase --architectures="$ARCH" --aptopt='Acquire::Languages "none"' \
		--include=python3,git,make,ca-certificates --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
		"$suite" "$ROOT.new" "deb $MIRROR $suite main" "deb $MIRROR-security $suite-security main"
	# pip brings its own certificates; a site with its own authority has them in the system's bundle.
	cp "$CERTIFICATES" "$ROOT.new/etc/ssl/certs/"
	# Every installed machine has this; a root that was unpacked has not.
	printf '127.0.0.1 localhost\n::1 localhost\n' >"$ROOT.new/etc/hosts"
	mv "$ROOT.new" "$ROOT"
	du -sm "$ROOT"
}
need_root() { [ -d "$ROOT" ] || make_root; }

# copy_root NAME COMMAND: $ROOT-NAME, a copy in which the command has run; made where there is none.
copy_root() {
	[ ! -d "$ROOT-$1" ] || return 0
	rm -rf --one-file-system "$ROOT-$1.new"
	cp -a --reflink=auto "$ROOT" "$ROOT-$1.new"
	IN=$ROOT-$1.new fetching in_root "$2"
	mv "$ROOT-$1.new" "$ROOT-$1"
}

# in_root COMMAND: as root, or with AS=user as a user, in $ROOT or $IN; the network is the machine's.
in_root() {
	systemd-nspawn --quiet --directory="${IN:-$ROOT}" --register=no --keep-unit --console=pipe --resolv-conf=copy-host \
		--user="${AS:-root}" ${QEMU_CPU:+--setenv=QEMU_CPU="$QEMU_CPU"} --setenv=PIP_CERT="$CERTIFICATES" \
		--setenv=SSL_CERT_FILE="$CERTIFICATES" ${PIP_INDEX_URL:+--setenv=PIP_INDEX_URL} ${BIND:+--bind-ro="$BIND"} \
		bash -euo pipefail -c "$1" </dev/null 2> >(grep -v 'Attempted to remove disk file system' >&2)
}

# What a root lacks to be booted.
need_booted_root() {
	copy_root systemd 'apt-get update -qq
		DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends systemd systemd-sysv dbus procps >/dev/null'
}

# boot_with SCRIPT [WORD...]: $ROOT-systemd booted; a script of this directory runs in it and ends it. Its words go to
# booted.log, and are shown. NSPAWN: more words for systemd-nspawn; returns what that ended with.
boot_with() {
	local look=$ROOT-systemd.look said=0
	rm -rf --one-file-system "$look"
	mkdir -p "$look"
	cp "$HERE/tests/platform/$1" "$HERE/tests/platform/looks.sh" "$look/"
	cat >"$ROOT-systemd/etc/systemd/system/look.service" <<-U
		[Service]
		Type=oneshot
		ExecStart=/bin/sh -c 'bash /run/look/$* >/run/look/booted.log 2>&1; systemctl exit \$?'
	U
	# shellcheck disable=SC2086 # the words of NSPAWN are words
	SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1 timeout --kill-after=20 "${LIMIT_S:-900}" systemd-nspawn --quiet --directory="$ROOT-systemd" \
		--boot --register=no ${QEMU_CPU:+--setenv=QEMU_CPU="$QEMU_CPU"} --keep-unit --private-network --console=pipe \
		--bind="$look:/run/look" ${NSPAWN:-} systemd.wants=look.service </dev/null >"$ROOT-systemd.log" 2>&1 || said=$?
	if [ ! -e "$look/booted.log" ]; then
		tail -n 20 "$ROOT-systemd.log"
		skip 'a machine on which systemd-nspawn boots a system (its last words are above)'
	fi
	cat "$look/booted.log"
	return $said
}
was_fine() { grep -q "^$1 FINE" "$ROOT-systemd.look/booted.log"; }

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

# A configuration that measures from the first moment on: pictures of the demonstration's noon instead of a camera.
# write_site DIRECTORY; node.toml is on standard input.
write_site() {
	local demo=$HERE/src/sagnode/demo/site
	mkdir -p "$1/frames"
	cp "$demo"/{span.toml,camera.yaml,reference.jpg} "$1/"
	cp "$demo"/frames/20260621T1{1,2,3}*.jpg "$1/frames/"
	cat >"$1/node.toml"
	chmod -R a+rX "$1"/*
}
