#!/bin/sh
# From pressures and flows of a flow loop to its circuits, and how well the record fixes them: sh fit.sh
# loop.csv holds three beats of a made-up loop; put your own record in its place.
# `valvefsi fit windkessel --help` says which columns and units a record may have.
set -e

# Downstream of the valve: the aortic pressure from the aortic flow.
# Pictures: fit.png (record and fit), profiles.png (how sharply the record fixes each parameter).
valvefsi fit windkessel loop.csv --circuit downstream --out downstream

# Upstream: the pump's pressure behind an impedance adapter. This record has no p_pump; with the adapter's values
# given it is worked out from q_lv and p_lv, and nothing is fitted. With a column p_pump leave --fix and --smooth out.
valvefsi fit windkessel loop.csv --circuit upstream-porcine \
    --fix R_1=0.1 --fix R_2=0.04 --fix C_VIA=0.3 --smooth 0.03 --out upstream

# What to change for a record of your own:
#   --column p_ao=P1:kPa                  a column that has another name and unit
#   --flip q_lv                           a flow that was recorded positive upstream
#   --lag fit                             the pressure lags behind the flow (tubing, filters)
#   --repair outliers, --gaps             spikes, missing samples
#   --fix R_c=0.05, --bounds C=0.5:5      a parameter that is known, or bounded (mmHg, ml, s)

# The way on: downstream/circuit.toml is what a case takes,
#   [[circuit]]
#   name = "aorta"
#   include = "downstream/circuit.toml"
# `valvefsi new valve DIR` writes the case of a valve that it fits into.
