"""What elements do at a position of their nodes: forces, viscosity, mass, quadrature points."""
