"""The solid: kinematics, materials, nodal forces, statics."""
