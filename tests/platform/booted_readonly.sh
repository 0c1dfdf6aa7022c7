#!/bin/bash
# Runs in the machine of booted_package.sh with a root that nobody can write to, but for /var/lib/sagnode and what lies in
# memory (bare_root.sh ... boot-package): what deploy/image/README.md says of such a root. Prints READONLY FINE.
set -euo pipefail
. "$(dirname "$0")/looks.sh"
export PAUSE_S=1

for place in /etc /usr /var/lib /var/log /root; do
	! touch "$place/written" 2>/dev/null || fail "$place can be written to, so that this shows nothing"
done
until_true 240 'on a root that is read-only the service came up by itself' systemctl is-active --quiet sagnode
so_far=$(journal "SELECT count(*) FROM readings WHERE validity = 'good'")
until_true 240 'and makes readings' good $((so_far + 3))
sagnode status >/dev/null || fail 'no status'
[ "$(restarts)" = 0 ] || fail 'systemd restarted the daemon'
! journalctl --no-pager -b -u sagnode -o cat | grep -i 'read-only file system' || fail 'it wanted to write elsewhere'
ok 'nothing that it wanted to write was refused'
stop_cleanly
echo 'READONLY FINE'
