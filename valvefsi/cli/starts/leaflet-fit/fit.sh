#!/bin/sh
# From planar biaxial tests of a leaflet to a material, and how well the tests fix it: sh fit.sh
# biaxial.csv holds five protocols of a made-up porcine leaflet; put your own record in its place.
# `valvefsi fit biaxial --help` says which columns a record may have.
set -e

# A material with one family of fibres, four of the protocols: the fifth is predicted, as a test of the fit.
# Pictures: fit.png (data, fit, prediction), profiles.png (how sharply the data fix each parameter).
valvefsi fit biaxial biaxial.csv --model hgo --families 1 --protocols 1,2,3,4 --starts 8 --out hgo

# The same with a material without fibres, to see what they are good for.
valvefsi fit biaxial biaxial.csv --model lee-sacks --starts 8 --out lee-sacks

# What to change for a record of your own:
#   --column stretch1=lx --column stretch2=ly     columns that have other names
#   --unit MPa                                    stress in a column without a unit
#   --thickness '0.4 mm'                          tensions (N/m) instead of stresses
#   --axis1 radial                                axis 1 of the test was radial, not circumferential
#   --fix kappa=0, --bounds k1=1:100              a parameter that is known, or bounded (kPa, degrees)

# The way on: hgo/material.toml is what a case takes,
#   material = { include = "hgo/material.toml" }
# `valvefsi new valve DIR` writes the case of a valve that it fits into.
