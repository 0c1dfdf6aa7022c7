#!/bin/bash
# Runs inside a booted machine on which deploy/install.sh has installed sagnode (bare_root.sh ... boot): the service is
# started, looked at, its worker and its daemon are killed and hung, and it is stopped. Prints BOOTED FINE at the end.
set -euo pipefail
. "$(dirname "$0")/looks.sh"

readings_are_kept() { [ -n "$(find /var/lib/sagnode -name 'journal*' -size +0)" ]; }

told_versions
[ "$(systemctl is-enabled sagnode)" = enabled ] || fail 'the service is not enabled'
ok 'the service is enabled'

# The example waits for a camera that is not here: grey pictures take its place. They show no conductor, so that every
# reading is invalid with a reason, which is what is wanted of them.
mkdir -p /etc/sagnode/frames
/opt/sagnode/current/venv/bin/python - <<'P'
import cv2, numpy as np
for i in range(400):
    picture = np.random.default_rng(i).integers(90, 160, (1088, 1456), np.uint8)
    cv2.imwrite(f"/etc/sagnode/frames/{i:04d}.jpg", picture)
P
cat >/etc/sagnode/camera.yaml <<'C'
image_width: 1456
image_height: 1088
camera_matrix: [[1739.0, 0, 728], [0, 1739.0, 544], [0, 0, 1]]
D: [0, 0, 0, 0, 0]
C
cat >/etc/sagnode/node.toml <<'C'
span_file = "span.toml"
[unit]
utility = "U"
line = "L"
span = "1-2"
unit = "n1"
[camera]
backend = "replay"
replay = { path = "frames", cadence_s = 1, start = "2026-06-21T12:00:00Z", at_end = "loop" }
[schedule]
interval_s = 1
deadline_s = 20
C
cat >/etc/sagnode/span.toml <<'C'
name = "1-2"
[[conductors]]
id = "A"
near = [0.0, 0.0, 20.0]
far = [0.0, 200.0, 20.0]
diameter_m = 0.02
sag_min_m = 1.0
sag_max_m = 10.0
[ground]
profile = [[0.0, 0.0], [200.0, 0.0]]
[camera]
position = [3.0, 0.0, 15.0]
azimuth_deg = 0
elevation_deg = 0
intrinsics = "camera.yaml"
C
sagnode config check --config /etc/sagnode || fail 'the configuration is refused'
mkdir -p /run/systemd/system/sagnode.service.d
printf '[Service]\nWatchdogSec=8\nRestartSec=1\n' >/run/systemd/system/sagnode.service.d/quick.conf
systemctl daemon-reload

systemctl restart sagnode || fail 'the service does not start'
ok "the service is ready: $(systemctl show --value -p StatusText sagnode)"
[ "$(ps -o user= -p "$(main_pid)")" = sagnode ] || fail 'the daemon does not run as sagnode'
[ "$(stat -c %U /var/lib/sagnode)" = sagnode ] || fail 'the state directory is not its own'
ok 'it runs as sagnode, with its own state directory'
exposure_is_low
sagnode-enrol --tls /root/tls request 2>/dev/null | openssl req -noout -subject | grep -q 'U/L/1-2/n1' || fail 'no request for a certificate'
ok 'sagnode-enrol is there, and asks for a certificate of this unit'"'"'s name'
printf 'memory %s MB, tasks %s\n' "$(($(systemctl show --value -p MemoryCurrent sagnode | grep -x '[0-9]*' || echo 0) / 1000000))" \
	"$(systemctl show --value -p TasksCurrent sagnode)"

until_true 120 'readings reach the journal' readings_are_kept
sleep 3

before=$(main_pid)
worker=$(worker_pid)
[ -n "$worker" ] || fail 'no worker process'
kill -9 "$worker"
until_true 120 'a killed worker is replaced' other_worker "$worker"
[ "$(main_pid)" = "$before" ] || fail 'the daemon ended with its worker'
ok 'and the daemon lives on'

kill -9 "$before"
until_true 120 'a killed daemon is started again' is_another "$before"
before=$(main_pid)
kill -STOP "$before"
until_true 240 'a hung daemon is ended by the watchdog and started again' is_another "$before"
systemctl show -p Result -p NRestarts sagnode

before=$(main_pid)
systemctl reload sagnode || fail 'reload'
sleep 2
[ "$(main_pid)" = "$before" ] || fail 'a reload restarted the daemon'
ok 'a reload keeps the daemon'
stop_cleanly

# Updates, without network: a release that runs, then three that must not stay.
version() { basename "$(readlink /opt/sagnode/current)"; }
journal_rows() { journal 'SELECT count(*) FROM readings'; }
update() { SETTLE_S=5 bash /packages/install.sh --from "/packages/$1.deb" >/root/update.log 2>&1; }
systemctl start sagnode
first=$(version)
until_true 120 'readings are made' readings_are_kept
began=$SECONDS
update good || fail "an update that should succeed: $(cat /root/update.log)"
[ "$(version)" = 0.90.1 ] && systemctl is-active --quiet sagnode || fail "after the update: $(version)"
[ "$(sagnode --version)" = 'sagnode 0.90.1' ] || fail "$(sagnode --version)"
ok "updated from $first to $(version) in $((SECONDS - began)) s, 5 of them to see it stay"
before=$(main_pid)
! update faulty || fail 'a release whose doctor finds faults was taken'
[ "$(version)" = 0.90.1 ] && [ "$(main_pid)" = "$before" ] || fail 'the daemon was disturbed'
ok 'a release whose doctor finds faults is not switched to, and the daemon not disturbed'
rows=$(journal_rows)
began=$SECONDS
! update broken || fail 'a release that does not start was taken'
[ "$(version)" = 0.90.1 ] && systemctl is-active --quiet sagnode || fail "after a broken update: $(version)"
[ ! -e /opt/sagnode/releases/0.90.2 ] || fail 'the broken release is left'
ok "a release that does not become ready: the old one is back and runs after $((SECONDS - began)) s"
! update later || fail 'a release that does not start was taken'
grep -q 'journal is as it was before' /root/update.log || fail "$(cat /root/update.log)"
[ "$(version)" = 0.90.1 ] && systemctl is-active --quiet sagnode || fail "after a broken update: $(version): $(cat /root/update.log)"
[ "$(journal_rows)" -ge "$rows" ] || fail "readings were lost: $(journal_rows) of $rows"
ok "one that had changed the journal's form before: the journal is back too, none of $rows readings lost"
SETTLE_S=5 bash /packages/install.sh --rollback >/root/update.log 2>&1 || fail "$(cat /root/update.log)"
[ "$(version)" = "$first" ] && systemctl is-active --quiet sagnode || fail "after the step back: $(version)"
ok "a step back to $(version)"

# The same by the timer, out of a directory with a signed list.
repository=/srv/repository
rm -rf "$repository"
mkdir -p "$repository" /run/systemd/system/sagnode-update.{service,timer}.d
for key in update other; do
	openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "/root/$key.key" 2>/dev/null
done
openssl pkey -in /root/update.key -pubout -out /etc/sagnode/update.pub
printf 'from = "%s"\nkey = "update.pub"\n' "$repository" >/etc/sagnode/update.toml
# offer RELEASE VERSION KEY
offer() {
	cp "/packages/$1.deb" "$repository/sagnode_$2+deb$(. /etc/os-release && echo "$VERSION_ID")_$(dpkg --print-architecture).deb"
	(cd "$repository" && sha256sum sagnode_*.deb >SHA256SUMS && openssl dgst -sha256 -sign "/root/$3.key" -out SHA256SUMS.sig SHA256SUMS)
}
told() { journalctl --no-pager -b -o cat -u sagnode-update | grep -q "$1" || fail "the update does not say: $1: $(journalctl --no-pager -b -o cat -u sagnode-update -n 20)"; }
is_version() { [ "$(sagnode --version)" = "sagnode $1" ] && systemctl is-active --quiet sagnode; }
printf '[Service]\nEnvironment=SETTLE_S=5\n' >/run/systemd/system/sagnode-update.service.d/quick.conf
printf '[Timer]\nOnCalendar=\nRandomizedDelaySec=0\nOnActiveSec=1s\nAccuracySec=1s\n' >/run/systemd/system/sagnode-update.timer.d/quick.conf
systemctl daemon-reload
[ "$(systemctl is-enabled sagnode-update.timer)" = disabled ] || fail 'the timer is on without being asked for'
offer good 0.90.1 other
! systemctl start sagnode-update 2>/dev/null || fail 'a list signed with another key was believed'
told 'is not signed with'
is_version "$first" || fail "after a list of another key: $(version)"
ok 'an update whose list another key signed is refused'
offer good 0.90.1 update
systemctl --quiet enable --now sagnode-update.timer || fail 'the timer does not start'
until_true 120 "the timer brings the release of a signed list: from $first to 0.90.1" is_version 0.90.1
while [ "$(systemctl is-active sagnode-update)" = activating ]; do sleep 0.5; done
told "0.90.1 follows $first"
systemctl --quiet disable --now sagnode-update.timer
offer broken 0.90.2 update
! systemctl start sagnode-update 2>/dev/null || fail 'a release that does not start was taken'
is_version 0.90.1 || fail "after a broken update: $(version)"
systemctl start sagnode-update || fail 'what was refused is tried again'
told 'is the latest .* that ran here'
ok 'one that does not become ready is put back and not tried again'
sagnode doctor --skip camera || fail 'doctor finds a fault'
systemctl stop sagnode

printf 'nonsense = 1\n' >>/etc/sagnode/node.toml
if systemctl restart sagnode 2>/dev/null; then fail 'a bad configuration was accepted'; fi
sleep 3
[ "$(systemctl show --value -p NRestarts sagnode)" = 0 ] || fail 'a bad configuration is tried again and again'
journalctl --no-pager -o cat -u sagnode -n 6
ok 'a bad configuration is refused once, with its fault'
echo 'BOOTED FINE'
