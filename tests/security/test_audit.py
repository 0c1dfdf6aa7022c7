"""scripts/audit.py against a small database in the form of the real one."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

AUDIT = Path(__file__).parents[2] / "scripts" / "audit.py"
ADVISORY = """
id: PYSEC-1
aliases: [CVE-1]
affected:
- package: {ecosystem: PyPI, name: Some.Package, purl: "pkg:pypi/some-package"}
  ranges:
  - type: GIT
    events: [{introduced: "0"}]
  - type: ECOSYSTEM
    events: [{introduced: "0"}, {fixed: "1.2"}, {introduced: "2.0"}, {fixed: "2.1.1"}]
  versions: ["1.0", "3.0"]
"""


def audit(tmp_path, version, advisory=ADVISORY):
    (tmp_path / "vulns" / "some-package").mkdir(parents=True, exist_ok=True)
    (tmp_path / "vulns" / "some-package" / "PYSEC-1.yaml").write_text(advisory)
    pinned = tmp_path / "requirements.txt"
    pinned.write_text(
        f"# a comment\nother==1.0 \\\n    --hash=sha256:00\nSome_Package=={version} \\\n    --hash=sha256:00\n"
    )
    words = [sys.executable, str(AUDIT), "--database", str(tmp_path), str(pinned)]
    return subprocess.run(words, capture_output=True, text=True)


@pytest.mark.parametrize("version", ["1.0", "1.1.9", "2.0", "2.1", "3.0", "1.2rc1"])
def test_an_affected_version_is_found(tmp_path, version):
    result = audit(tmp_path, version)
    assert result.returncode == 1, result.stderr
    assert f"some-package {version}: PYSEC-1 CVE-1" in result.stdout


@pytest.mark.parametrize("version", ["1.2", "1.9", "2.1.1", "3.1"])
def test_one_that_is_not_is_not(tmp_path, version):
    result = audit(tmp_path, version)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "2 packages, 1 advisories" in result.stdout


def test_what_was_withdrawn_does_not_count_and_what_is_no_database_is_told(tmp_path):
    assert audit(tmp_path, "1.0", ADVISORY + "withdrawn: 2024-01-01\n").returncode == 0
    result = subprocess.run(
        [sys.executable, str(AUDIT), "--database", str(AUDIT.parent)], capture_output=True, text=True
    )
    assert result.returncode == 2 and "no checkout of the advisory database" in result.stderr


@pytest.fixture
def judge():
    spec = importlib.util.spec_from_file_location("audit", AUDIT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.judge


def test_what_pip_audit_did_not_look_up_is_not_taken_for_sound(judge, capsys):
    sound = {"name": "Some_Package", "version": "1.2", "vulns": []}
    skipped = {"name": "other", "skip_reason": "Dependency not found on PyPI and could not be audited: other (1.0)"}
    holed = sound | {"vulns": [{"id": "PYSEC-1", "fix_versions": [], "aliases": ["CVE-1"], "description": ""}]}
    assert judge("f", {"dependencies": [sound], "fixes": []}, {"some-package"}) == 0
    assert judge("f", {"dependencies": [holed], "fixes": []}, {"some-package"}) == 1
    assert "Some_Package 1.2: PYSEC-1 CVE-1" in capsys.readouterr().out
    for report in ([sound, skipped], [sound]):
        assert judge("f", {"dependencies": report, "fixes": []}, {"some-package", "other"}) == 2
        said = capsys.readouterr().err
        assert "no answer about other" in said and "make audit DATABASE=" in said
