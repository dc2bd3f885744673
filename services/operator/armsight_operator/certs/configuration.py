"""The Zenoh configuration of each bearer of a certificate: TLS on both sides, and the router's access control.

Files are named relative to the folder of the configuration: a bearer's folder works wherever it is put.
"""

import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from armsight.topics import WHO
from armsight_operator.certs.layout import CA_COPY, CERTIFICATE, KEY, ROUTER
from armsight_operator.certs.rights import rights
from armsight_operator.errors import CertificateError

_HEAD = """// Made by `armsight certs make`, which writes it again whenever it runs. Paths are relative to this file.
// The rights come from the contract's table, proto/armsight/topics.toml.
"""


def router_configuration(
    listen: Sequence[str],
    roles: Mapping[str, str],
    namespaces: Sequence[str],
    others: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> dict[str, Any]:
    """A router's: listens with mutual TLS and lets nothing pass that the table doesn't name.

    Args:
        listen: its endpoints.
        roles: what each bearer of a certificate may do, by name.
        namespaces: robots that the rights are for.
        others: for whom the routers speak that it is linked to, as roles by a router's name.
    """
    return {
        "mode": "router",
        "listen": {"endpoints": list(listen)},
        "transport": {"link": {"tls": _tls(serves=True)}},
        "access_control": access_control(roles, namespaces, others),
    }


def client_configuration(role: str, connect: Sequence[str], namespace: str) -> dict[str, Any]:
    """A service's or a person's: connects with its own certificate, to a router whose name and certificate fit."""
    return {
        "mode": "client",
        # for whoever is given it to see whether it is his: what it lets him do is in the certificate
        "metadata": {"role": role},
        "connect": {"endpoints": list(connect)},
        "namespace": namespace,
        "transport": {"link": {"tls": _tls(serves=False)}},
    }


def access_control(
    roles: Mapping[str, str],
    namespaces: Sequence[str],
    others: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> dict[str, Any]:
    """Zenoh's access control: rules by role, subjects by the common name of their certificate.

    Another router is one subject: through it passes what any of those may do for whom it speaks.
    """
    bearers = {role: sorted(name for name, own in roles.items() if own == role) for role in WHO}
    rules, subjects, policies = [], [], []
    for role in (role for role in WHO if bearers[role]):
        granted = {
            f"{role}: {flow} {message}": {"flows": [flow], "messages": [message], "key_exprs": list(keys)}
            for (flow, message), keys in rights(role, namespaces).items()
        }
        rules += [{"id": name, "permission": "allow", **rule} for name, rule in granted.items()]
        subjects.append({"id": role, "cert_common_names": bearers[role]})
        policies.append({"id": role, "rules": list(granted), "subjects": [role]})
    for router, behind in others.items():
        granted = {
            f"{router} for {role}: {flow} {message}": {"flows": [flow], "messages": [message], "key_exprs": list(keys)}
            for role in behind
            for (flow, message), keys in rights(role, namespaces, behind_router=True).items()
        }
        rules += [{"id": name, "permission": "allow", **rule} for name, rule in granted.items()]
        subjects.append({"id": f"{router} as a router", "cert_common_names": [router]})
        policies.append({"id": f"{router} as a router", "rules": list(granted), "subjects": [f"{router} as a router"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def check_routers(roles: Mapping[str, str], routers: Mapping[str, Sequence[str]]) -> None:
    """Whether it is said of every further router for whom it speaks.

    Args:
        roles: what each bearer of a certificate may do, by name.
        routers: for whom each further router speaks.

    Raises:
        CertificateError: it is not, or is said of somebody else.
    """
    for name, behind in routers.items():
        if unknown := sorted(set(behind) - set(WHO)):
            raise CertificateError(f"router {name} can't speak for {', '.join(unknown)}: there are {', '.join(WHO)}")
    if ROUTER in routers:
        raise CertificateError(f"{ROUTER} is the first router, to which others are linked: it speaks for everybody")
    further = {name for name, role in roles.items() if role == ROUTER and name != ROUTER}
    if unsaid := sorted(further - set(routers)):
        raise CertificateError(f"{unsaid[0]} is a router, too: say for whom, such as --router {unsaid[0]}=sim,vision")


def configuration_text(configuration: Mapping[str, Any]) -> str:
    """The file's content."""
    return f"{_HEAD}{json.dumps(configuration, indent=2)}\n"


def _tls(*, serves: bool) -> dict[str, Any]:
    # the router connects as well: to ask itself for its health
    sides = ("connect", "listen") if serves else ("connect",)
    return {
        "root_ca_certificate": CA_COPY,
        "enable_mtls": True,
        "verify_name_on_connect": True,
        # whoever is connected when a certificate expires is not for ever
        "close_link_on_expiration": True,
        **{f"{side}_private_key": KEY for side in sides},
        **{f"{side}_certificate": CERTIFICATE for side in sides},
    }


def configurations(
    roles: Mapping[str, str],
    listen: Sequence[str],
    connect: Sequence[str],
    namespaces: Sequence[str],
    routers: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> dict[str, str]:
    """Everybody's, by name.

    Args:
        roles: what each bearer of a certificate may do, by name.
        listen: endpoints of every router.
        connect: endpoints at which everybody else finds it.
        namespaces: robots that the rights are for.
        routers: further ones that connect to the first, and for whom each speaks. The first speaks for everybody.
    """

    def text(name: str, role: str) -> str:
        if role != ROUTER:
            return configuration_text(client_configuration(role, connect, namespaces[0]))
        others = routers if name == ROUTER else {ROUTER: WHO}
        return configuration_text(router_configuration(listen, roles, namespaces, others if routers else {}))

    return {name: text(name, role) for name, role in roles.items()}
