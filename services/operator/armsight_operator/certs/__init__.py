"""Identity and access: a certificate for everybody on the bus, and what each may do there."""
