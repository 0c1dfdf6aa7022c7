#!/bin/bash
# Runs inside a bare Debian root as root (bare_root.sh ... deb): the package is installed, used, upgraded, removed, purged,
# and nothing of it is left. /packages holds sagnode.deb and newer.deb, the same with a higher version. Prints PACKAGE FINE.
set -euo pipefail
export DEBIAN_FRONTEND=noninteractive
. "$(dirname "$0")/looks.sh"
# Everything on the disk but caches, logs, what apt and dpkg keep for themselves, and the backups of the user database.
listing() {
	find / -xdev \( -path /proc -o -path /sys -o -path /dev -o -path /run -o -path /tmp -o -path /packages -o -path /var/cache \
		-o -path /var/lib/apt -o -path /var/lib/dpkg -o -path /var/log -o -path '/etc/*-' \
		-o -path /etc/ld.so.cache -o -path /root -o -path /home \) -prune -o -print |
		LC_ALL=C sort
}

apt-get update -qq
# A run that failed or was interrupted may have left it.
dpkg --configure -a
! dpkg-query -W sagnode >/dev/null 2>&1 || apt-get purge -y -qq sagnode
# What the package depends on first, so that what is left at the end is the package's own.
apt-get install -y -qq --no-install-recommends python3 adduser libstdc++6 libgcc-s1 init-system-helpers >/dev/null
listing >/tmp/before
getent passwd | LC_ALL=C sort >/tmp/users-before
# On a machine that does other work as well, the processor's time says more than the clock.
TIMEFORMAT='%0R %0U %0S'
{ time apt-get install -y -qq --no-install-recommends /packages/sagnode.deb 2>&3; } 3>&2 2>/tmp/took
read -r took user system </tmp/took
ok "installed in $took s, $((user + system)) s of a processor; $(du -sm /usr/lib/sagnode | cut -f1) MB in /usr/lib/sagnode"
[ "$took" -le 300 ] || [ $((user + system)) -le 300 ] || fail 'longer than five minutes'
[ "$(du -sm /usr/lib/sagnode | cut -f1)" -le 300 ] || fail 'more than 300 MB'
! command -v gcc cc >/dev/null || fail 'a compiler came along'

ok "$(cd / && sagnode --version), $(python3 --version), $(uname -m)"
[ "$(stat -c '%U:%G %a' /etc/sagnode /etc/sagnode/node.toml | tr '\n' ' ')" = 'root:sagnode 750 root:sagnode 640 ' ] ||
	fail "rights of the configuration: $(stat -c '%U:%G %a' /etc/sagnode /etc/sagnode/node.toml | tr '\n' ' ')"
id sagnode | grep -q video || fail 'the user is not in the group video'
ok 'the configuration is the service'"'"'s to read, and the user may use cameras'

# A reading, as the service's user, out of the demonstration's pictures that come with the package.
site=$(echo /usr/lib/sagnode/venv/lib/python3.*/site-packages/sagnode/demo/site)
mkdir -p /tmp/site && cp -r "$site"/. /tmp/site && rm -f /tmp/site/frames/*T0* && chmod -R a+rX /tmp/site
measure() {
	(cd /tmp && runuser -u sagnode -- env SAGNODE_NATIVE="$1" sagnode measure /tmp/site/frames/20260621T120000Z.jpg --config /tmp/site --json)
}
reading() {
	measure 1 >/tmp/reading.json
	python3 - <<-'P'
		import json
		for r in json.load(open("/tmp/reading.json"))["readings"]:
		    assert r["quality"]["validity"] == "good", r["quality"]
		    print(f"ok    {r['conductor']}: sag {r['sag_m']:.4f} m, u {r['sag_u']:.4f} m")
	P
}
began=$(date +%s)
reading || fail "no reading: $(head -c 400 /tmp/reading.json)"
ok "a reading in $(($(date +%s) - began)) s"
# The module that was compiled for this processor, against NumPy on the same processor.
(cd /tmp && /usr/lib/sagnode/venv/bin/python -c 'import sys; from sagnode.native import why_not; sys.exit(why_not or 0)') ||
	fail 'the compiled kernels are not in use'
measure 0 >/tmp/plain.json || fail "no reading without the compiled kernels: $(head -c 400 /tmp/plain.json)"
python3 - <<-'P' || fail 'the compiled kernels measure something else'
	import json
	one, other = (json.load(open(f"/tmp/{name}.json"))["readings"] for name in ("reading", "plain"))
	most = max(abs(a["sag_m"] - b["sag_m"]) / b["sag_u"] for a, b in zip(one, other, strict=True))
	assert most <= 0.01, most
	print(f"ok    the compiled kernels are in use; without them the sags are the same within {most:.5f} u")
P
runuser -u sagnode -- sagnode doctor --config /tmp/site || fail 'doctor finds a fault'
rm -rf /tmp/site

printf '# mine\n' >>/etc/sagnode/node.toml
apt-get install -y -qq --no-install-recommends /packages/newer.deb
[ "$(tail -n 1 /etc/sagnode/node.toml)" = '# mine' ] || fail 'the upgrade touched the configuration'
[ "$(find /usr/lib/sagnode -name '*.pyc' | wc -l)" -gt 500 ] || fail 'not compiled'
apt-get install -y -qq --no-install-recommends --allow-downgrades /packages/sagnode.deb
ok 'an upgrade and the step back keep the configuration'
apt-get remove -y -qq sagnode
[ ! -e /usr/lib/sagnode ] || fail "left: $(find /usr/lib/sagnode | head -n 3)"
[ -e /etc/sagnode/node.toml ] || fail 'remove took the configuration'
apt-get purge -y -qq sagnode
listing >/tmp/after
getent passwd | LC_ALL=C sort >/tmp/users-after
diff /tmp/before /tmp/after || fail 'files are left'
diff /tmp/users-before /tmp/users-after || fail 'a user is left'
ok 'removed and purged: nothing is left'
echo 'PACKAGE FINE'
