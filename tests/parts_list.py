"""The list of a wheel's parts (software bill of materials, CycloneDX 1.5), from what is installed here.

The wheel is the list's subject, `metadata.component`; the packages that it needs are its components: `required` are
those that pip installs with it, on whichever processor, `optional` those of its extras. A package that is not installed
here is listed as well, but without version and licence, which are not known then.
"""

import email
import hashlib
import importlib.metadata
import importlib.util
import json
import uuid
import zipfile
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.message import Message
from importlib.metadata import Distribution, PackageNotFoundError
from itertools import product
from pathlib import Path

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

SPECIFICATION = "1.5"
MACHINES = ("x86_64", "aarch64", "armv7l")
OF_DEVELOPERS = {"test", "docs"}  # extras that no user installs


@dataclass
class Package:
    """One that is needed: its distribution, if it is installed, and the packages that it needs itself."""

    scope: str
    distribution: Distribution | None = None
    needs: set[str] = field(default_factory=set)


def applies(requirement: Requirement, extras: set[str]) -> bool:
    """Whether its marker holds on one of the machines, without an extra or with one of these."""
    marker, choices = requirement.marker, product(MACHINES, ("", *extras))
    return marker is None or any(marker.evaluate({"platform_machine": at, "extra": extra}) for at, extra in choices)


def add_needed(lines: list[str], extras: set[str], scope: str, found: dict[str, Package]) -> set[str]:
    """Add what these lines of Requires-Dist require, and what that requires; returns the names in the lines."""
    names = set()
    for requirement in map(Requirement, lines):
        if not applies(requirement, extras):
            continue
        name = canonicalize_name(requirement.name)
        names.add(name)
        if name not in found:
            package = found[name] = Package(scope)
            try:
                package.distribution = importlib.metadata.distribution(name)
            except PackageNotFoundError:
                continue
            package.needs = add_needed(package.distribution.requires or [], set(requirement.extras), scope, found)
    return names


def licences(metadata: Message) -> list[dict[str, object]]:
    """As an SPDX expression if it is one, else as a name; empty if the package does not say."""
    named = metadata.get("License-Expression") or metadata.get("License")
    if named is None:
        classifiers = metadata.get_all("Classifier", [])
        found = [line.rpartition(" :: ")[2] for line in classifiers if line.startswith("License ::")]
        return [{"license": {"name": name}} for name in found]
    try:
        return [{"expression": str(canonicalize_license_expression(named))}]
    except InvalidLicenseExpression:
        return [{"license": {"name": named.splitlines()[0]}}]


def component(kind: str, name: str, metadata: Message | None, **more: object) -> dict[str, object]:
    """One component; `metadata` is a package's METADATA, None if it is not installed."""
    version = "" if metadata is None else metadata["Version"]
    purl = f"pkg:pypi/{name}@{version}" if version else f"pkg:pypi/{name}"
    known = {} if metadata is None else {"version": version, "licenses": licences(metadata)}
    return {"type": kind, "bom-ref": purl, "name": name, "purl": purl, **known, **more}


def parts_list(built: Path) -> dict[str, object]:
    """The parts list of a wheel."""
    with zipfile.ZipFile(built) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        own = email.message_from_bytes(archive.read(name))
    found: dict[str, Package] = {}
    lines, extras = own.get_all("Requires-Dist", []), set(own.get_all("Provides-Extra", [])) - OF_DEVELOPERS
    needs = add_needed(lines, set(), "required", found) | add_needed(lines, extras, "optional", found)

    digest = hashlib.sha256(built.read_bytes()).hexdigest()
    subject = component("application", "imud", own, hashes=[{"alg": "SHA-256", "content": digest}])
    parts = {
        name: component("library", name, package.distribution and package.distribution.metadata, scope=package.scope)
        for name, package in sorted(found.items())
    }
    graph = {"imud": needs, **{name: package.needs for name, package in sorted(found.items())}}
    references = {name: part["bom-ref"] for name, part in [("imud", subject), *parts.items()]}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": SPECIFICATION,
        "serialNumber": uuid.uuid5(uuid.NAMESPACE_URL, f"sha256:{digest}").urn,
        "version": 1,
        "metadata": {"timestamp": datetime.now(UTC).isoformat(timespec="seconds"), "component": subject},
        "components": list(parts.values()),
        "dependencies": [
            {"ref": references[name], "dependsOn": [references[other] for other in sorted(others)]}
            for name, others in graph.items()
        ],
    }


def defect(parts: dict[str, object]) -> str | None:
    """What CycloneDX's own schema finds wrong with a parts list; None: nothing."""
    if not importlib.util.find_spec("cyclonedx"):
        return "not looked for: pip install 'cyclonedx-python-lib[json-validation]'"
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    found = JsonStrictValidator(SchemaVersion.from_version(SPECIFICATION)).validate_str(json.dumps(parts))
    return None if found is None else str(found)
