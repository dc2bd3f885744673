"""Live views in other people's applications: the bus as their protocols have it."""
