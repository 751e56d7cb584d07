"""Parameter files of Nav2 for one test, and what becomes of them."""

from typing import Any

import pytest
import yaml

from mazebot.common.config import ConfigError
from mazebot.common.nav2_params.loader import load_nav2_params
from mazebot.common.nav2_params.report import Report, Row, report
from mazebot.common.nav2_params.targets import Models
from mazebot.localization.config import LocalizationConfig
from mazebot.navigation.config import NavigationConfig

MODELS: Models = {"navigation": NavigationConfig, "localization": LocalizationConfig}


def told(node: str, values: dict[str, Any]) -> Report:
    """What becomes of a file with one node."""
    text = yaml.safe_dump({node: {"ros__parameters": values}}, sort_keys=False)
    return report(load_nav2_params(text, "my.yaml"), MODELS)


def refused(node: str, values: dict[str, Any]) -> str:
    """Why such a file is refused, in one line."""
    with pytest.raises(ConfigError) as caught:
        told(node, values)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def row_of(found: Report, parameter: str) -> Row:
    """What becomes of a parameter."""
    (row,) = [row for row in found.rows if row.parameter == parameter]
    return row


def config_of(found: Report) -> NavigationConfig:
    """Navigation's configuration with what comes of a file."""
    return NavigationConfig.model_validate(found.settings.get("navigation", {}))
