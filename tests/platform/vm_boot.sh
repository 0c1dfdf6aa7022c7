#!/bin/bash
# Runs in the virtual machine (vm.sh run vm_boot.sh): how long from power-on to the first reading, at the broker too?
set -euo pipefail
LIMIT_S=60
. "$(dirname "$0")/looks.sh"
first() { journalctl --no-pager -b -o short-monotonic -u sagnode | sed -n "s/^\[ *\([0-9.]*\)\].* $1.*/\1/p" | head -n 1; }
until [ -n "$(first 'is good')" ] || [ "$(cut -d. -f1 /proc/uptime)" -gt 240 ]; do sleep 1; done
reading=$(first 'is good')
[ -n "$reading" ] || fail 'no good reading within four minutes'
printf 'ok    the daemon %.1f s, its worker %.1f s, the first good readings %.1f s after the kernel began\n' \
	"$(first 'sagnode .*state in')" "$(first 'worker .* ready')" "$reading"
awk -v t="$reading" -v limit="$LIMIT_S" 'BEGIN {exit !(t <= limit)}' || fail "later than $LIMIT_S s"
until systemctl is-active --quiet mosquitto || [ "$(cut -d. -f1 /proc/uptime)" -gt 240 ]; do sleep 1; done
message=$(timeout 90 mosquitto_sub -h localhost -t 'sagnode/v1/U/L/+/vm1/measurement/L1' -C 1) || fail 'nothing at the broker'
printf 'ok    at the broker: %s\n' "$(printf '%s' "$message" | tr ',' '\n' | grep -E '"(sag_m|sag_u|validity)"' | tr '\n' ' ')"
exposure_is_low
sagnode doctor || fail 'doctor finds a fault'
