"""The paper's methods as it prints them, kept to be compared with: Abed, Trabelsi, Derbel, Energies 2025, 18, 5767.

Equation and section numbers in this package are that paper's. What the paper leaves open is decided in the docstring of
the function that needs it. Pictures come here without lens distortion (section 3.3.4), and so are all pixels.
"""
