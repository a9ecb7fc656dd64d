"""
The software bill of materials of a distribution, in CycloneDX: this package, libmodbus and cffi.

Wheels have it in the folder of PEP 770, for what they carry; the sdist, for which there is no such
rule, beside this file.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
import uuid
from datetime import UTC, datetime
from pathlib import Path

import libmodbus
from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import (
    ExternalReference,
    ExternalReferenceType,
    HashAlgorithm,
    HashType,
    XsUri,
)
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.component_evidence import ComponentEvidence, Occurrence
from cyclonedx.model.contact import OrganizationalEntity
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

FOLDER, NAME = "sboms", "libmodbus-py.cdx.json"
"""Where wheels have the file: in this folder of their .dist-info."""

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"

LICENCES = LicenseFactory()


def sbom(place: str, content: bytes) -> str:
    """
    Return the bill of materials as JSON; its time is SOURCE_DATE_EPOCH.

    Args:
        place: the path in the distribution where libmodbus is, as a library or as its source.
        content: the bytes of this file.

    Raises:
        SystemExit: it does not follow the schema of CycloneDX.
    """
    project = tomllib.loads(PYPROJECT.read_text())["project"]
    authors = OrganizationalEntity(name=project["authors"][0]["name"])
    own = _component(project["name"], project["version"], project["license"], supplier=authors)
    carried = _libmodbus(place, content)
    (needed,) = project["dependencies"]
    cffi = _component(
        "cffi",
        text=f"not carried, but needed: {needed}",
        supplier=OrganizationalEntity(
            name="The cffi project", urls=[XsUri("https://cffi.readthedocs.io")]
        ),
    )
    made = datetime.fromtimestamp(int(os.environ["SOURCE_DATE_EPOCH"]), UTC)
    about = BomMetaData(component=own, timestamp=made, supplier=authors)
    bom = Bom(components=[carried, cffi], metadata=about)
    bom.register_dependency(own, [carried, cffi])
    # A random one would make no two builds equal.
    bom.serial_number = uuid.uuid5(uuid.NAMESPACE_URL, hashlib.sha256(content).hexdigest())
    text = JsonV1Dot6(bom).output_as_string(indent=2)
    mistake = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if mistake is not None:
        raise SystemExit(f"sbom: {mistake}")
    return f"{text}\n"


def _component(
    name: str,
    version: str | None = None,
    licence: str = "",
    text: str | None = None,
    *,
    supplier: OrganizationalEntity,
) -> Component:
    url = PackageURL("pypi", name=name, version=version)
    return Component(
        name=name,
        version=version,
        type=ComponentType.LIBRARY,
        bom_ref=str(url),
        purl=url,
        description=text,
        supplier=supplier,
        licenses=[LICENCES.make_from_string(licence)] if licence else [],
    )


def _libmodbus(place: str, content: bytes) -> Component:
    source = libmodbus.PLACES[0]
    checksum = {"checksum": f"sha256:{libmodbus.SHA256}", "download_url": source}
    url = PackageURL("generic", name="libmodbus", version=libmodbus.VERSION, qualifiers=checksum)
    return Component(
        name="libmodbus",
        version=libmodbus.VERSION,
        type=ComponentType.LIBRARY,
        bom_ref=f"libmodbus@{libmodbus.VERSION}",
        purl=url,
        # As the National Vulnerability Database names it, for scanners.
        cpe=f"cpe:2.3:a:libmodbus:libmodbus:{libmodbus.VERSION}:*:*:*:*:*:*:*",
        supplier=OrganizationalEntity(
            name="The libmodbus project", urls=[XsUri("https://libmodbus.org")]
        ),
        licenses=[LICENCES.make_from_string("LGPL-2.1-or-later")],
        hashes=[_sha256(hashlib.sha256(content).hexdigest())],
        evidence=ComponentEvidence(occurrences=[Occurrence(location=place)]),
        external_references=[
            ExternalReference(
                type=ExternalReferenceType.SOURCE_DISTRIBUTION,
                url=XsUri(source),
                hashes=[_sha256(libmodbus.SHA256)],
            ),
            ExternalReference(
                type=ExternalReferenceType.WEBSITE, url=XsUri("https://libmodbus.org")
            ),
        ],
    )


def _sha256(digest: str) -> HashType:
    return HashType(alg=HashAlgorithm.SHA_256, content=digest)
