"""Recordings: what goes over the bus as MCAP files, and from them back onto the bus, into reports and tables."""
