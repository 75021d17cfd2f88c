"""Make and manage the keys of sessions across machines.

On one machine nothing is to be done: processes of one user make their own keys. Across machines a
private authority gives each process a certificate of its role and session:

  teleop keys init authority                      once: make an authority, in a folder kept safe
  teleop keys issue authority --session bench --role master --out console-keys
  teleop keys issue authority --session bench --role slave --role recorder --out robot-keys
  teleop keys issue authority --session bench --role supervisor --right stop --out desk-keys
  teleop keys show robot-keys                     what is in a folder, and until when it is valid
  teleop keys revoke authority console-keys/bench.master.pem

Copy each folder of `--out` to its machine, by a way that nobody else reads (scp), and name it in
the config: `link: {keys: robot-keys}`. The folder `authority` stays where it is: who has its
authority.key can issue himself anything.

Roles: master, slave, supervisor (`teleop run`, `stop` and `set`; `--right` limits it to stop, reset
or set), recorder, viewer, router (`--session all` for the router of all sessions).

After `revoke`, copy authority/revoked.pem into the folder of keys of each machine. Running
processes read it within seconds and part from the holder.
"""

import argparse
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from teleop.errors import UsageError
from teleop.runtime.output_file import SharedFolder
from teleop.security.authority import (
    AUTHORITY,
    AUTHORITY_DAYS,
    AUTHORITY_KEY,
    CERTIFICATE_DAYS,
    Authority,
)
from teleop.security.credentials import build_file_stem
from teleop.security.identity import (
    ALL_SESSIONS,
    RIGHTS,
    CertificateRole,
    Identity,
    identify_holder,
)
from teleop.security.key_files import (
    CertificateError,
    is_signed_by,
    load_certificate,
    load_key,
    read_common_name,
    write_file,
    write_key,
)
from teleop.security.revocation import REVOKED, load_revoked
from teleop.session.config import check_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions of `teleop keys`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    init = actions.add_parser("init", help="make an authority")
    init.add_argument("folder", type=Path, metavar="DIR", help="new folder of the authority")
    init.add_argument("--name", default="teleop authority", help="its name in certificates")
    _add_days_option(init, AUTHORITY_DAYS)
    issue = actions.add_parser("issue", help="issue certificates of roles in a session")
    issue.add_argument("folder", type=Path, metavar="DIR", help="folder of the authority")
    issue.add_argument(
        "--session", required=True, metavar="NAME", help="as in the config; all, for a router"
    )
    issue.add_argument(
        "--role",
        action="append",
        required=True,
        choices=[role.value for role in CertificateRole],
        help="may be repeated",
    )
    issue.add_argument(
        "--right",
        action="append",
        choices=RIGHTS,
        help="what a supervisor may do, may be repeated (default all three)",
    )
    issue.add_argument(
        "--out", type=SharedFolder(), required=True, metavar="DIR", help="folder of the keys"
    )
    _add_days_option(issue, CERTIFICATE_DAYS)
    revoke = actions.add_parser("revoke", help="take a certificate back")
    revoke.add_argument("folder", type=Path, metavar="DIR", help="folder of the authority")
    revoke.add_argument("which", metavar="FILE|SERIAL", help="certificate, or its serial number")
    show = actions.add_parser("show", help="show the certificates of a folder")
    show.add_argument("folder", type=Path, metavar="DIR", help="of an authority, or of keys")


def main(args: argparse.Namespace) -> int:
    """Do what is asked; returns the exit code."""
    actions: dict[str, Callable[[argparse.Namespace], int]] = {
        "init": _init_authority,
        "issue": _issue_certificates,
        "revoke": _revoke_certificates,
        "show": _show_folder,
    }
    return actions[args.action](args)


def _add_days_option(parser: argparse.ArgumentParser, days: int) -> None:
    parser.add_argument(
        "--days",
        type=_parse_days,
        default=float(days),
        metavar="N",
        help=f"how long it is valid (default {days})",
    )


def _parse_days(text: str) -> float:
    try:
        days = float(text)
    except ValueError:
        days = 0.0
    if not 0.0 < days <= 36500.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of days, above 0 to 36500")
    return days


def _init_authority(args: argparse.Namespace) -> int:
    if (args.folder / AUTHORITY_KEY).exists() or (args.folder / AUTHORITY).exists():
        raise UsageError(f"{args.folder}: has an authority already; choose another folder")
    if not 1 <= len(args.name) <= 64:
        raise UsageError("--name: allowed are 1 to 64 characters")
    authority = Authority.create(args.name, args.days)
    authority.save(args.folder)
    print(f"{args.folder}: authority until {authority.certificate.not_valid_after_utc:%Y-%m-%d}")
    print(f"keep {args.folder / AUTHORITY_KEY} secret: it can issue every certificate")
    print(f"next: teleop keys issue {args.folder} --session NAME --role master --out console-keys")
    return 0


def _issue_certificates(args: argparse.Namespace) -> int:
    authority = Authority.load(args.folder)
    session = ALL_SESSIONS if args.session == "all" else args.session
    if session != ALL_SESSIONS:
        try:
            check_session(session)
        except ValueError as error:
            raise UsageError(f"--session {session}: {error}") from error
    offices = list(dict.fromkeys(map(CertificateRole, args.role)))
    if session == ALL_SESSIONS and offices != [CertificateRole.ROUTER]:
        raise UsageError("--session all: only for --role router; name the session of the others")
    if args.right and CertificateRole.SUPERVISOR not in offices:
        raise UsageError("--right: only for --role supervisor")
    paths = {role: args.out / f"{build_file_stem(role, session)}.pem" for role in offices}
    existing = [path for path in paths.values() if path.exists()]
    if existing and not args.force:
        raise UsageError(f"{existing[0]}: exists; --force replaces it")
    kept = args.out / AUTHORITY
    if kept.exists() and load_certificate(kept) != authority.certificate:
        raise UsageError(f"{args.out}: has keys of another authority; choose another --out")
    _require_shorter_validity(args.days, authority)
    authority.publish(args.out)
    for role, path in paths.items():
        rights = (
            tuple(sorted(set(args.right or RIGHTS))) if role is CertificateRole.SUPERVISOR else ()
        )
        certificate, key = authority.issue(Identity(role, session, rights), args.days)
        write_key(path.with_suffix(".key"), key)
        write_file(path, certificate.public_bytes(Encoding.PEM), 0o644)
        print(f"{path}: {_format_certificate(certificate)}")
    return 0


def _require_shorter_validity(days: float, authority: Authority) -> None:
    """Raise `UsageError` if certificates would outlive their authority, which ends them."""
    end = authority.certificate.not_valid_after_utc
    if datetime.now(UTC) + timedelta(days=days) > end:
        raise UsageError(
            f"--days: the authority itself ends on {end:%Y-%m-%d}; choose fewer days, or make a "
            "new authority"
        )


def _revoke_certificates(args: argparse.Namespace) -> int:
    authority = Authority.load(args.folder)
    serial = _parse_serial(args.which, authority)
    if serial in authority.revoked:
        raise UsageError(f"{args.which}: is revoked already")
    authority.revoke(serial).publish(args.folder)
    print(f"revoked {serial:x}")
    print(f"now copy {args.folder / REVOKED} into the folder of keys of each machine")
    return 0


def _parse_serial(which: str, authority: Authority) -> int:
    if Path(which).is_file():
        certificate = load_certificate(Path(which))
        if not is_signed_by(certificate, authority.certificate):
            raise UsageError(f"{which}: is of another authority, which alone can revoke it")
        return certificate.serial_number
    try:
        serial = int(which, 16)
    except ValueError as error:
        raise UsageError(f"{which}: neither a file nor a serial number (hexadecimal)") from error
    if not 0 < serial < 1 << 159:
        raise UsageError(f"{which}: not a serial number of a certificate")
    return serial


def _show_folder(args: argparse.Namespace) -> int:
    authority = load_certificate(args.folder / AUTHORITY)
    revoked = load_revoked(args.folder, authority)
    with_key = "" if not (args.folder / AUTHORITY_KEY).exists() else ", with its private key"
    print(f"authority {read_common_name(authority)}: {_format_validity(authority)}{with_key}")
    for path in sorted(args.folder.glob("*.*.pem")):
        certificate = load_certificate(path)
        try:
            identify_holder(certificate, authority, revoked)
            load_key(path.with_suffix(".key"))
            fault = ""
        except (CertificateError, UsageError) as error:
            fault = f"; NOT usable: {error}"
        print(f"{path.name}: {_format_certificate(certificate)}{fault}")
    for serial in sorted(revoked):
        print(f"revoked: {serial:x}")
    return 0


def _format_certificate(certificate: x509.Certificate) -> str:
    return (
        f"{read_common_name(certificate)}, {_format_validity(certificate)}, "
        f"serial {certificate.serial_number:x}"
    )


def _format_validity(certificate: x509.Certificate) -> str:
    end = certificate.not_valid_after_utc
    days_left = (end - datetime.now(UTC)).days
    return f"valid until {end:%Y-%m-%d %H:%M} UTC" + (
        f" ({days_left} days)" if days_left >= 0 else ""
    )
