"""The fluid on a staggered grid."""
