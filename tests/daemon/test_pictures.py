"""Pictures keep to their quota and make room for the readings; real files, a disk whose room is told by hand."""

import os

from sagnode.daemon.machine import Machine
from sagnode.daemon.pictures import Pictures


class HandMachine(Machine):
    """A disk of so many megabytes, of which the files and so much else are used."""

    def __init__(self, directory, size_mb, others_mb=0.0):
        super().__init__()
        self.directory, self.size_mb, self.others_mb = directory, size_mb, others_mb

    def disk_size_mb(self, directory):
        return self.size_mb

    def disk_free_mb(self, directory):
        used = sum(file.stat().st_size for file in self.directory.iterdir()) / 1e6
        return max(0.0, self.size_mb - self.others_mb - used)


def draw(directory, count, size=100_000):
    directory.mkdir()
    for number in range(count):
        file = directory / f"L{number}.jpg"
        file.write_bytes(bytes(size))
        os.utime(file, (number, number))


def left(directory):
    return sorted(file.name for file in directory.iterdir())


def test_the_oldest_go_when_the_quota_is_reached(tmp_path):
    place = tmp_path / "pictures"
    draw(place, 5)
    assert Pictures(place, 0.25, HandMachine(place, 1000)).room() == place
    assert left(place) == ["L3.jpg", "L4.jpg"]


def test_the_oldest_go_when_the_disk_runs_short_and_half_written_ones_with_them(tmp_path):
    place = tmp_path / "pictures"
    draw(place, 5)
    (place / "L0.jpg").rename(place / "L0.jpg.part")
    assert Pictures(place, 10, HandMachine(place, 1000, others_mb=949.75)).room() == place
    assert left(place) == ["L3.jpg", "L4.jpg"]


def test_all_go_and_none_are_drawn_when_others_fill_the_disk(tmp_path, caplog):
    place = tmp_path / "pictures"
    draw(place, 5)
    machine = HandMachine(place, 1000, others_mb=990)
    pictures = Pictures(place, 10, machine)
    assert pictures.room() is None
    assert left(place) == []
    assert "only 10 MB free; readings go on without them" in caplog.text
    machine.others_mb = 100
    assert pictures.room() == place


def test_a_small_file_system_in_memory_has_a_reserve_that_fits_it(tmp_path):
    place = tmp_path / "pictures"
    draw(place, 5)
    machine = HandMachine(place, 40)
    assert Pictures(place, 10, machine).room() == place
    machine.others_mb = 31
    assert Pictures(place, 10, machine).room() is None


def test_a_directory_that_cannot_be_made_costs_the_pictures_alone(tmp_path, caplog):
    (tmp_path / "pictures").write_text("in the way")
    assert Pictures(tmp_path / "pictures", 10, Machine()).room() is None
    assert "readings go on without them" in caplog.text
