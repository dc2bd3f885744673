"""`armsight certs make | renew | show`: who is who on the bus, and what each may do there."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="Make, renew and show certificates, and the router's rules of who may do what.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

DAYS, CA_DAYS = 90, 3650
_LONGEST_DAYS = 36500

_HOSTS = ("localhost", "127.0.0.1", "::1", "router")
"""Where a router is on one machine, and in the compose file."""

Folder = Annotated[Path, typer.Option("--folder", help="Where keys, certificates and configurations are.")]
Days = Annotated[int, typer.Option("--days", help="How long certificates hold.", min=1, max=_LONGEST_DAYS)]
Hosts = Annotated[
    list[str] | None,
    typer.Option(
        "--host",
        metavar="HOST",
        help=f"Further name or address of the router, may be given again. [always: {', '.join(_HOSTS)}]",
        show_default=False,
    ),
]


@app.command()
def make(
    folder: Folder = Path("certs"),
    name: Annotated[
        list[str] | None,
        typer.Option(
            "--name",
            metavar="NAME=ROLE",
            help="Somebody else with a certificate, may be given again; roles: sim, vision, control, camera, recorder, "
            "operator, viewer.",
            show_default=False,
        ),
    ] = None,
    router: Annotated[
        list[str] | None,
        typer.Option(
            "--router",
            metavar="NAME=ROLE,ROLE",
            help="Another router, linked to the first, and whom it speaks for, such as edge=sim,vision; may be given "
            "again.",
            show_default=False,
        ),
    ] = None,
    host: Hosts = None,
    namespace: Annotated[
        list[str] | None,
        typer.Option(
            "--namespace",
            metavar="NAME",
            help="Robot that the rights are for, may be given again. [default: robots/arm]",
            show_default=False,
        ),
    ] = None,
    listen: Annotated[str, typer.Option(help="Where the router listens.")] = "tls/127.0.0.1:7447",
    connect: Annotated[
        str, typer.Option(help="Where everybody else finds it; the name must be one of its hosts.")
    ] = "tls/localhost:7447",
    days: Days = DAYS,
    ca_days: Annotated[
        int, typer.Option(help="How long the certificate authority holds.", min=1, max=_LONGEST_DAYS)
    ] = CA_DAYS,
) -> None:
    """Make an authority, a certificate for everybody, and their Zenoh configurations with the router's rules.

    Keys and certificates that are there are kept: run it again to add somebody, or after an update brought new keys of
    the bus. Configurations are written anew each time, as the flags say.

    Example: armsight certs make --name wall=viewer
    """
    from armsight.errors import ConfigError
    from armsight.session import DEFAULT_NAMESPACE, SessionConfig
    from armsight.topics import EACH
    from armsight_operator.certs import folder as certificates
    from armsight_operator.certs.configuration import check_routers, configurations
    from armsight_operator.certs.layout import CONFIGURATION, ROUTER

    namespaces = namespace or [DEFAULT_NAMESPACE]
    for robot in namespaces:
        SessionConfig(endpoints=(listen, connect), namespace=robot)  # refuses what is none
    if wrong := [endpoint for endpoint in (listen, connect) if not endpoint.startswith(("tls/", "quic/"))]:
        raise ConfigError(f"endpoint {wrong[0]!r} has no certificates: it is tls/HOST:PORT")
    bearers = {ROUTER: ROUTER}
    bearers |= {role: role for role in (*EACH, "operator")}
    bearers |= dict(_name_and_role(text) for text in name or ())
    routers = dict(_router_and_roles(text) for text in router or ())
    bearers |= dict.fromkeys(routers, ROUTER)
    files = certificates.Folder(folder)
    check_routers({**files.roles(), **bearers}, routers)
    done = files.make(bearers, _HOSTS, days, ca_days, tuple(host or ()))
    texts = configurations(files.roles(), [listen], [connect], namespaces, routers)
    for bearer, text in texts.items():
        files.write_configuration(bearer, text)
    for bearer, what in done.items():
        print(f"{bearer}: {what}")
    configuration = folder / "NAME" / CONFIGURATION
    print(f"everybody's configuration is {configuration}, for {', '.join(namespaces)} at {connect}")
    if done[ROUTER] == "kept":
        print("a router that runs takes new rules when it starts again")
        if host:
            print(f"its certificate was kept: `armsight certs renew router --host {host[0]}` adds a host")


@app.command()
def renew(
    names: Annotated[list[str] | None, typer.Argument(help="Whose; nobody named: everybody's.")] = None,
    folder: Folder = Path("certs"),
    host: Hosts = None,
    days: Days = DAYS,
    new_keys: Annotated[bool, typer.Option("--new-keys", help="Replace the private keys, too.")] = False,
) -> None:
    """Sign new certificates by the same authority; keys, names and rights stay.

    Services take theirs when they next connect, the router when it starts again: restart it before its old one expires.

    Example: armsight certs renew router --host robot.local
    """
    from armsight_operator.certs import folder as certificates
    from armsight_operator.certs.layout import ROUTER

    expires = certificates.Folder(folder).renew(names or (), days, tuple(host or ()), new_keys=new_keys)
    for bearer, until in expires.items():
        print(f"{bearer}: until {until:%Y-%m-%d}")
    if ROUTER in expires:
        print("now start the router again: everybody reconnects, with the new certificates, within a second")


@app.command()
def show(folder: Folder = Path("certs")) -> None:
    """Show every certificate with its expiry. Exit code 1 where one can't be used, or expires in less than 14 days.

    Example: armsight certs show --folder certs
    """
    from rich.console import Console
    from rich.table import Table

    from armsight_operator.certs import folder as certificates

    now = datetime.now(UTC)
    entries = certificates.Folder(folder).entries(now)
    table = Table("name", "may act as", "reached as", "expires", "days", "trouble", box=None, pad_edge=False)
    for entry in entries:
        hosts, until = ", ".join(entry.hosts), f"{entry.expires:%Y-%m-%d %H:%M}Z"
        table.add_row(entry.name, entry.role, hosts, until, str((entry.expires - now).days), entry.trouble)
    Console(width=None if sys.stdout.isatty() else 160, highlight=False).print(table)
    if any(entry.trouble for entry in entries):
        raise typer.Exit(1)


def _name_and_role(text: str) -> tuple[str, str]:
    from armsight.errors import ConfigError

    name, equals, role = text.partition("=")
    if not (name and equals and role):
        raise ConfigError(f"--name {text!r} does not say what it may do: it is NAME=ROLE, such as wall=viewer")
    return name, role


def _router_and_roles(text: str) -> tuple[str, tuple[str, ...]]:
    from armsight.errors import ConfigError

    name, equals, roles = text.partition("=")
    if not (name and equals and roles):
        raise ConfigError(f"--router {text!r} does not say whom it speaks for: it is NAME=ROLE,ROLE")
    return name, tuple(roles.split(","))
