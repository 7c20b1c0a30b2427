"""Least-squares fits of materials and circuits."""
