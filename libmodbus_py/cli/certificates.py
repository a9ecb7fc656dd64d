"""
The command certificates: those for trying Modbus Security, or those of the machines of a fleet; and
what becomes of them: they are listed, renewed and revoked.
"""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from .output import counted
from .parser import Parser, declare

if TYPE_CHECKING:
    from ..tools.authority import Authority

HOSTS = ("localhost", "127.0.0.1", "::1")

ROLES = ("Viewer", "Operator", "Engineer")

ENDPOINT = "tls://127.0.0.1:1802"
"""The endpoint of the example commands: only root can listen on port 802."""

DAYS = 365
"""Of certificates and of the revocation list."""

AUTHORITY_DAYS = 3650
"""Ten years: the authority of machines outlives their certificates, which are made again."""

DESCRIPTION = """\
Make certificates of an authority, a server, clients with roles and a client
without one. They are for trials only: the key of the authority is in the same
folder.

With MACHINE, make those of an authority and of each machine instead. Copy
DIR/MACHINE/ (ca.pem, server.pem, server-key.pem) to the machine, and keep
DIR/ca-key.pem. The authority is made once; a machine gets a new certificate
each time.

--list, --renew, --revoke and --crl are for the certificates in DIR. A NAME is
that of a file, such as viewer, or of a MACHINE. Servers use DIR/crl.pem with
--crl, and read their files again on SIGHUP."""

EXAMPLES = """\
examples:
  libmodbus-py certificates certs --host plc.example --role Operator --days 30
  libmodbus-py certificates fleet n1.example n2.example n3.example
  libmodbus-py certificates certs server --renew --days 90
  libmodbus-py certificates certs --revoke operator"""

ARGUMENTS = f"""
DIR
    folder for the files; existing files are not overwritten
[MACHINE ...]
    name or address of a machine of a fleet; with --renew, the NAME of a certificate
--host NAME ...
    name or address of the server, besides {", ".join(HOSTS)}; may be repeated
--role NAME ...
    role of a client; may be repeated ({", ".join(ROLES)})
--days N
    days of validity (365; of a renewed certificate as before)
--list
    print name, serial number, days left and purpose of each certificate
--renew
    make the certificates of these names again, with the same keys; without a name all but the
    authority and those that are revoked
--revoke SERIAL|NAME ...
    add a certificate to the revocation list DIR/crl.pem; may be repeated
--crl
    write the revocation list again, for --days from now
"""


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, EXAMPLES
    declare(command, ARGUMENTS, dir={"type": Path})
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    actions = [name for name in ("list", "renew", "revoke", "crl") if getattr(options, name)]
    if not actions:
        options.days = DAYS if options.days is None else options.days
        return _make(options)
    if actions[1:]:
        raise ValueError(f"--{actions[0]} and --{actions[1]} must be given one after the other")
    if options.host or options.role or (options.machine and not options.renew):
        raise ValueError(f"--{actions[0]} takes neither MACHINE nor --host nor --role")
    from ..tools.authority import Authority

    authority = Authority(options.dir)
    if options.list:
        _list(authority)
    elif options.renew:
        for path in authority.renew(options.machine, options.days):
            print(path)
    else:
        for serial in authority.revoke(options.revoke or ()):
            print(f"{serial}: revoked")
        print(authority.write_list(DAYS if options.days is None else options.days))
    return 0


def _list(authority: Authority) -> None:
    now = datetime.now(UTC)

    def left(end: datetime) -> str:
        days = (end - now).total_seconds() / 86_400
        return counted(int(days), "day") if days >= 0 else "expired"

    rows = [
        (row.name, row.serial, "revoked" if row.is_revoked else left(row.ends), row.purpose)
        for row in authority.issued().values()
    ]
    if authority.list_ends is not None:
        rows.append((authority.list_path.stem, "", left(authority.list_ends), "revocation list"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print(
            "  ".join(f"{text:{width}}" for text, width in zip(row, widths, strict=True)).rstrip()
        )


def _make(options: argparse.Namespace) -> int:
    if not options.machine:
        return _make_for_trials(options)
    if options.host or options.role:
        raise ValueError("--host and --role are for trials, without MACHINE")
    return _make_for_machines(options.dir, dict.fromkeys(options.machine), options.days)


def _make_for_machines(directory: Path, machines: Iterable[str], days: int) -> int:
    from ..tools.certificates import load, make, write

    for machine in machines:
        if "/" in machine or machine in (".", ".."):
            raise ValueError(f"MACHINE {machine!r} is neither an address nor a name")
    authority = load(directory, "ca")
    is_new = authority is None
    authority = authority or make("Modbus authority", is_authority=True, days=AUTHORITY_DAYS)
    files = {machine: make(machine, authority, hosts=[machine], days=days) for machine in machines}
    if is_new:
        write(directory, {"ca": authority}, replaces=True)  # a key alone cannot be used
    for machine, identity in files.items():
        folder = directory / machine
        write(folder, {"server": identity}, replaces=True)
        (folder / "ca.pem").write_bytes(authority.pem)
        print(folder)
    return 0


def _make_for_trials(options: argparse.Namespace) -> int:
    from ..tools.certificates import make, write

    hosts = tuple(dict.fromkeys([*HOSTS, *(options.host or ())]))
    days = options.days
    authority = make("Modbus trial authority", is_authority=True, days=days)
    certificates = {
        "ca": (authority, "the authority"),
        "server": (
            make("Modbus trial server", authority, hosts=hosts, days=days),
            f"the server {', '.join(hosts)}",
        ),
        "no-role": (
            make("Modbus trial client without a role", authority, days=days),
            "a client without a role",
        ),
    }
    for role in options.role or ROLES:
        file = re.sub(r"\W+", "-", role.lower()).strip("-")
        if not file or file in certificates or file == "crl":
            raise ValueError(f"--role {role!r} gives no file name of its own, but {file!r}")
        identity = make(f"Modbus trial {role}", authority, role=role, days=days)
        certificates[file] = identity, f"a client with the role {role}"
    paths = write(options.dir, {file: identity for file, (identity, _) in certificates.items()})
    for file, (certificate, key) in paths.items():
        print(f"{certificate}, {key.name}: {certificates[file][1]}")

    def options_of(file: str) -> str:
        files = zip(("cert", "key", "ca"), (*paths[file], paths["ca"][0]), strict=True)
        return " ".join(f"--{option} {shlex.quote(str(path))}" for option, path in files)

    client = [*certificates][3]  # the first role
    print("\nTo try them:")
    print(f"  libmodbus-py serve {ENDPOINT} {options_of('server')}")
    print(f"  libmodbus-py read {ENDPOINT} holding 0 {options_of(client)}")
    return 0
