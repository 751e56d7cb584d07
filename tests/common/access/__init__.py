"""Identities, and what they may do on the bus."""
