"""Health figures out of made-up /proc and /sys trees, and of this machine."""

import pytest

from sagnode.daemon.machine import Machine


@pytest.fixture
def tree(tmp_path):
    def write(path, text):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return Machine(tmp_path)

    return write


def test_an_empty_machine_is_all_unknown(tmp_path):
    machine = Machine(tmp_path)
    assert machine.cpu_temperature_c() is None
    assert machine.throttled() is None
    assert machine.memory_available_mb() is None
    assert machine.boot_id() == ""
    assert machine.disk_free_mb(tmp_path / "nowhere") is None


def test_the_processors_own_zone_is_preferred(tree):
    tree("sys/class/thermal/thermal_zone0/type", "battery\n")
    tree("sys/class/thermal/thermal_zone0/temp", "71000\n")
    assert tree("sys/class/thermal/thermal_zone1/type", "gpu\n").cpu_temperature_c() == 71.0
    tree("sys/class/thermal/thermal_zone2/type", "cpu-thermal\n")
    assert tree("sys/class/thermal/thermal_zone2/temp", "48312\n").cpu_temperature_c() == 48.312


def test_garbage_in_sysfs_is_unknown(tree):
    tree("sys/class/thermal/thermal_zone0/type", "cpu-thermal")
    assert tree("sys/class/thermal/thermal_zone0/temp", "hot\n").cpu_temperature_c() is None
    assert tree("proc/meminfo", "MemAvailable: many kB\n").memory_available_mb() is None


@pytest.mark.parametrize(("bits", "now"), [("0", False), ("50000", False), ("50005", True), ("4", True)])
def test_throttled_means_now(tree, bits, now):
    assert tree("sys/devices/platform/soc/soc:firmware/get_throttled", bits + "\n").throttled() is now


def test_undervoltage_by_hwmon(tree):
    tree("sys/class/hwmon/hwmon0/name", "cpu_thermal")
    tree("sys/class/hwmon/hwmon1/name", "rpi_volt")
    assert tree("sys/class/hwmon/hwmon1/in0_lcrit_alarm", "1").throttled() is True


def test_memory(tree):
    assert tree("proc/meminfo", "MemTotal: 1000 kB\nMemAvailable:  312000 kB\n").memory_available_mb() == 312.0


def test_this_machine(tmp_path):
    machine = Machine()
    assert len(machine.boot_id()) == 36
    assert machine.memory_available_mb() > 10
    assert machine.disk_free_mb(tmp_path) > 0
    assert machine.clock_trust().source in {"kernel", "systemd-timesyncd", "nobody says"}
