"""Files: checkpoints, histories, ParaView series, pictures."""
