"""Showing the configuration in effect."""

from __future__ import annotations

import json
import tomllib

import pytest
from config_files import SiteFiles

from sagnode.config.load import load_any, load_node
from sagnode.config.node import Node
from sagnode.config.show import as_document, as_toml
from sagnode.config.span import Span


@pytest.mark.parametrize("changed", [False, True])
def test_what_is_shown_is_the_configuration_itself(site: SiteFiles, changed: bool) -> None:
    loaded = load_node(site.node)
    document = json.loads(json.dumps(as_document(loaded, changed=changed)))
    assert Node.model_validate(document["node"]) == loaded.node
    assert Span.model_validate(document["span"]) == loaded.span
    text = as_toml(loaded, changed=changed)
    node_text, span_text = text.split("# span:")
    assert Node.model_validate(tomllib.loads(node_text)) == loaded.node
    assert Span.model_validate(tomllib.loads("#" + span_text)) == loaded.span


def test_changed_leaves_the_defaults_out_and_full_has_them(site: SiteFiles) -> None:
    loaded = load_node(site.node)
    assert "deadline_s" not in as_toml(loaded, changed=True)
    assert "deadline_s = 60.0" in as_toml(loaded)
    assert "interval_s = 300.0" in as_toml(loaded, changed=True)


def test_a_span_alone_is_shown_without_a_node(site: SiteFiles) -> None:
    document = as_document(load_any(site.span))
    assert "node" not in document
    assert document["span_path"] == str(site.span)
