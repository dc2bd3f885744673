"""Names in a bearer's folder."""

ROUTER = "router"

KEY, CERTIFICATE, CA_COPY, CONFIGURATION = "key.pem", "certificate.pem", "ca.pem", "zenoh.json5"
