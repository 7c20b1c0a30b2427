"""Files only: checkpoints, histories, ParaView series."""
