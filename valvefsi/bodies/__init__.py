"""What the coupled step moves and spreads: elastic bodies, heavy ones, rigid ones."""
