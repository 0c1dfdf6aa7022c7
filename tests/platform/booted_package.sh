#!/bin/bash
# Runs in a booted machine on which the package was installed (bare_root.sh ... boot-package): the package's service comes up
# by itself, measures the demonstration's noon, has its worker killed, is hung, reloaded and stopped. Prints BOOTED FINE.
#
# EMULATED=yes where programs are emulated one by one (qemu-aarch64), some ten times slower than the machine: then nothing
# is hung on purpose, since a watchdog with such patience would take minutes.
set -euo pipefail
. "$(dirname "$0")/looks.sh"
export PAUSE_S=1
patience_s=240
[ "${EMULATED:-no}" = no ] || patience_s=600

# The broker's password lies in a file that only root reads; systemd hands it to the daemon, which shows it to the broker.
password_comes_as_a_credential() {
	local drop_in=/run/systemd/system/sagnode.service.d/credential.conf
	install -m 0600 /dev/null /etc/sagnode/mqtt-password
	echo 'known-to-root-alone' >/etc/sagnode/mqtt-password
	cp -p /etc/sagnode/node.toml /run/node.toml
	printf '[mqtt]\nhost = "localhost"\nport = 18830\nusername = "unit"\npassword_file = "mqtt-password"\n' >>/etc/sagnode/node.toml
	mkdir -p "${drop_in%/*}"
	sed -n 's/^#\(LoadCredential=\)/[Service]\n\1/p' /usr/lib/systemd/system/sagnode.service >"$drop_in"
	systemctl daemon-reload
	ip link set lo up 2>/dev/null || true
	timeout "$patience_s" python3 - <<-'P' &
		import socket
		door = socket.create_server(("127.0.0.1", 18830))
		caller, said = door.accept()[0], b""
		while b"known-to-root-alone" not in said:
		    more = caller.recv(1000)
		    assert more, said
		    said += more
	P
	systemctl restart sagnode || fail 'the service does not start with a credential'
	wait $! || fail 'the password did not reach the broker'
	! grep -l "known-to-root[-]alone" /proc/[0-9]*/cmdline /proc/[0-9]*/environ || fail 'the password is in a command line or an environment'
	cp -p /run/node.toml /etc/sagnode/node.toml
	ok 'a password that only root can read reaches the broker by LoadCredential=, and stands in no command line or environment'
}

told_versions
began=$SECONDS
until_true "$patience_s" 'the service of the package came up by itself and said that it is ready' systemctl is-active --quiet sagnode
[ "$(ps -o user= -p "$(main_pid)")" = sagnode ] || fail 'the daemon does not run as sagnode'
until_true "$patience_s" 'three good readings are in the journal' good 3
first_good_readings
ok "$((SECONDS - began)) s after the look began"

before=$(main_pid)
so_far=$(journal "SELECT count(*) FROM readings WHERE validity = 'good'")
kill -9 "$(worker_pid)"
until_true "$patience_s" 'a killed worker is replaced, and readings come again' good $((so_far + 3))
[ "$(main_pid)" = "$before" ] || fail 'the daemon ended with its worker'
systemctl reload sagnode || fail 'reload'
sleep 5
[ "$(main_pid)" = "$before" ] && systemctl is-active --quiet sagnode || fail 'a reload restarted the daemon'
[ "$(restarts)" = 0 ] || fail 'systemd restarted the daemon'
ok 'a reload keeps the daemon; systemd and its watchdog never had to start it anew'
if [ "${EMULATED:-no}" = no ]; then
	exposure_is_low
	password_comes_as_a_credential
	before=$(main_pid)
	kill -STOP "$before"
	until_true "$patience_s" 'a hung daemon is ended by the watchdog and started again' is_another "$before"
fi
stop_cleanly
echo 'BOOTED FINE'
