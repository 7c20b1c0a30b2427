"""What the process runs on: threads, memory, compiled loops, the differences between DOLFINx releases."""
