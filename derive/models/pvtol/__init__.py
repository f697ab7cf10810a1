"""The PVTOL: a planar vertical take-off and landing aircraft with thrust and rolling moment."""
