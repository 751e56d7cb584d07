"""Completes the software bill of materials of the image, while it is built.

    sbom.py CYCLONEDX_JSON PYPROJECT TARGET

Takes the Python packages as cyclonedx-bom has found them, adds the Debian packages that the image
keeps files of, names the product, and leaves out addresses of package registries: they are those of
the machine that has built the image.
"""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path
from typing import Any

STATUS = Path("/var/lib/dpkg/status")


def main(source: Path, project: Path, target: Path) -> None:
    """Write the bill."""
    bill = json.loads(source.read_text())
    about = tomllib.loads(project.read_text())["project"]
    bill["components"] = [*map(_without_addresses, bill.get("components", [])), *debian_packages()]
    bill["metadata"]["component"] = {
        "type": "container", "bom-ref": "mazebot", "name": about["name"],
        "version": about["version"],
    }  # fmt: skip
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(bill, indent=1) + "\n")


def _without_addresses(component: dict[str, Any]) -> dict[str, Any]:
    kept = [
        one for one in component.get("externalReferences", []) if one.get("type") != "distribution"
    ]
    return {**component, "externalReferences": kept}


def debian_packages() -> list[dict[str, Any]]:
    """The installed packages of Debian as components of CycloneDX."""
    found = []
    for text in STATUS.read_text().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in text.splitlines() if ": " in line[:30])
        if "installed" not in fields.get("Status", ""):
            continue
        name, version, arch = (fields[key] for key in ("Package", "Version", "Architecture"))
        purl = f"pkg:deb/debian/{name}@{version}?arch={arch}&distro=bookworm"
        found.append(
            {"type": "library", "bom-ref": purl, "name": name, "version": version, "purl": purl}
        )
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
