"""Solids alone, as exactly incompressible statics."""
