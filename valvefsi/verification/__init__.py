"""How far numbers may be trusted: norms, observed order, grid convergence, results gathered."""
