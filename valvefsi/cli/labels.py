"""What the waveforms of a valve are called on the terminal."""

from __future__ import annotations

LABELS = {
    "p_lv": "P_LV",
    "p_ao": "P_Ao",
    "q_ao": "Q_Ao",
    "q_ao_without_offset": "Q_Ao without offset",
    "pdva": "PDVA",
}
