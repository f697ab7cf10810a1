"""What the Pendubot paper prints: equations (1)-(48), and the values and statements around them.

Only what stands in print; nothing here is derived, corrected or checked. Parts of an equation
that are not its own left or right side say in their name what they are: `line2` the second line,
`limit` a limit that is claimed. q10, dq10 ... are initial values; `integral` runs from 0 to t;
`lower` is the underlined lambda of (13), `K1`, `K2`, `K3` the underlined kappas of (42), `gm`, `gM`
gamma_m and gamma_M of (44). zeta and sigma are one letter in print.
"""

from __future__ import annotations

from collections.abc import Mapping

from pfaffian.paper.audit.paper import Paper

_S = "lam*dq1 + lam*lam1*(q1 - pi/2) + dq2 + lam2*q2"
_ARC = f"(2*eta/pi)*atan({_S})"
_SUM = f"(2*eta/pi)*integral(atan({_S}))"
_DET = "(theta1*theta2 - theta3**2*cos(q2)**2)"
_DECAY = "-2*kappa*lower*norm(beta)**2"
_REST = "2*norm(bhat)*(alpha - ahat).T*Pi"
_GAP = "(ahat - alpha)"

EQUATIONS: Mapping[int, Mapping[str, str]] = {
    1: {
        "theta1": "m1*lc1**2 + m2*l1**2 + I1",
        "theta2": "m2*lc2**2 + I2",
        "theta3": "m2*l1*lc2",
        "theta4": "m1*lc1 + m2*l1",
        "theta5": "m2*lc2",
        "M": "rows([theta1 + theta2 + 2*theta3*cos(q2), theta2 + theta3*cos(q2)],"
        " [theta2 + theta3*cos(q2), theta2])",
        "C": "rows([-theta3*dq2, -theta3*(dq2 + dq1)], [theta3*dq1, 0])*sin(q2)",
        "G": "rows([theta4*g*cos(q1) + theta5*g*cos(q1 + q2)], [theta5*g*cos(q1 + q2)])",
        "B": "rows([1], [0])",
        "left": "M*ddq + C*dq + G + F",
        "right": "B*tau",
    },
    2: {"left": "ds + sigma*s", "right": "-(2*eta/pi)*atan(s)", "limit": "eta"},
    3: {"s": "lam*(de1 + lam1*e1) + (de2 + lam2*e2)"},
    4: {"e1": "q1 - q1d", "e2": "q2 - q2d", "q1d": "pi/2", "q2d": "0"},
    5: {
        "left": "lam*ddq1 + lam*lam1*dq1 + ddq2 + lam2*dq2"
        " + sigma*(lam*dq1 + lam*lam1*(q1 - pi/2) + dq2 + lam2*q2)",
        "right": f"-{_ARC}",
    },
    6: {
        "left": "lam*(dq1 - dq10) + lam*lam1*(q1 - q10) + (dq2 - dq20) + lam2*(q2 - q20)"
        " + sigma*lam*(q1 - q10) + sigma*lam*lam1*integral(q1 - pi/2) + sigma*(q2 - q20)"
        " + sigma*lam2*integral(q2)",
        "right": f"-{_SUM}",
    },
    7: {
        "A": "rows([lam, 1])",
        "b": "-lam*lam1*dq1 - lam2*dq2"
        f" - sigma*(lam*dq1 + lam*lam1*(q1 - pi/2) + dq2 + lam2*q2) - {_ARC}",
        "c": "lam*dq10 - lam*lam1*(q1 - q10) + dq20 - lam2*(q2 - q20) - sigma*lam*(q1 - q10)"
        " - sigma*(q2 - q20) - sigma*lam*lam1*integral(q1 - pi/2) - sigma*lam2*integral(q2)"
        f" - {_SUM}",
    },
    8: {"first": "A*dq - c", "second": "A*ddq - b"},
    9: {"sum": "B*Fhat + dF", "null": "B.T*dF"},
    10: {"ADB": f"lam*theta2/{_DET}"},
    11: {"Fhat": "(A*D*B)**-1*A*D*F", "dF": "F - B*Fhat"},
    12: {"zero": "A*D*dF"},
    13: {"left": "A*D*B*B.T*D*A.T", "bound": "lower"},
    14: {"left": "norm(Fhat)", "bound": "alpha.T*Pi"},
    15: {"rate": "k1*Pi*norm(bhat) - k2*ahat"},
    16: {"tau": "p1 + p2 + p3"},
    17: {"p1": "(A*D*B)**-1*(b + A*D*(C*dq + G))"},
    18: {"p2": "-kappa*bhat"},
    19: {"p3": "-gamma*mu*ahat.T*Pi"},
    20: {"bhat": "B.T*D*A.T*beta"},
    21: {"beta": "A*dq - c"},
    22: {"mu": "bhat*ahat.T*Pi"},
    23: {"outside": "1/norm(mu)", "inside": "1/epsilon", "where": "norm(mu) - epsilon"},
    24: {"V": f"beta.T*beta + k1**-1*{_GAP}.T*{_GAP}"},
    25: {"rate": f"2*beta.T*dbeta + 2*k1**-1*{_GAP}.T*dahat"},
    26: {
        "line1": "2*beta.T*(A*ddq - b)",
        "line2": "2*beta.T*(A*M**-1*((-C*dq - G - F) + B*(p1 + p2 + p3)) - b)",
        "line3": "2*beta.T*(A*D*((-C*dq - G) + (B*p1 + B*p2) - F + B*p3) - b)",
    },
    27: {"zero": "A*D*((-C*dq - G) + B*p1) - b"},
    28: {"left": "A*D*F", "line1": "A*D*B*Fhat + A*D*dF", "line2": "A*D*B*Fhat + 0"},
    29: {"rate": "-2*beta.T*A*D*B*Fhat + 2*beta.T*A*D*B*p2 + 2*beta.T*A*D*B*p3"},
    30: {
        "left": "-2*beta.T*A*D*B*Fhat",
        "line1": "2*norm(B.T*D*A.T*beta)*norm(Fhat)",
        "line2": "2*norm(bhat)*alpha.T*Pi",
    },
    31: {"left": "2*beta.T*A*D*B*p2", "right": "2*beta.T*A*D*B*(-kappa*B.T*D*A.T*beta)"},
    32: {
        "left": "2*beta.T*A*D*B*(-kappa*B.T*D*A.T*beta)",
        "line1": "-2*kappa*beta.T*(A*D*B*B.T*D*A.T)*beta",
        "line2": _DECAY,
    },
    33: {"left": "2*beta.T*A*D*B*p2", "right": _DECAY},
    34: {
        "left": "2*beta.T*A*D*B*p3",
        "line1": "2*beta.T*A*D*B*(-gamma*mu*ahat.T*Pi)",
        "line2": "-2*gamma*beta.T*A*D*B*mu*ahat.T*Pi",
        "line3": "-2*gamma*norm(mu)**2",
    },
    35: {"left": "-2*gamma*norm(mu)**2", "right": "-2*norm(mu)"},
    36: {"left": "-2*gamma*norm(mu)**2", "right": "-2*norm(mu)**2/epsilon"},
    37: {
        "left": "2*beta.T*dbeta",
        "line1": f"{_DECAY} - 2*norm(mu) + 2*norm(bhat)*alpha.T*Pi",
        "line2": f"{_DECAY} - 2*norm(bhat)*ahat.T*Pi + 2*norm(bhat)*alpha.T*Pi",
        "line3": f"{_DECAY} + {_REST}",
    },
    38: {
        "left": "2*beta*dbeta",
        "line1": f"{_DECAY} - 2*norm(mu)**2/epsilon + 2*norm(bhat)*alpha.T*Pi",
        "line2": f"{_DECAY} - 2*norm(mu)**2/epsilon + 2*norm(bhat)*ahat.T*Pi"
        " - 2*norm(bhat)*ahat.T*Pi + 2*norm(bhat)*alpha.T*Pi",
        "line3": f"{_DECAY} - 2*norm(mu)**2/epsilon + 2*norm(mu) + {_REST}",
        "line4": f"{_DECAY} - 2*(norm(mu)**2/epsilon - norm(mu)) + {_REST}",
        "line5": f"{_DECAY} + 2*(1/(4/epsilon)) + {_REST}",
        "line6": f"{_DECAY} + epsilon/2 + {_REST}",
    },
    39: {"left": "2*beta*dbeta", "right": f"{_DECAY} + epsilon/2 + {_REST}"},
    40: {
        "left": f"2*k1**-1*{_GAP}.T*dahat",
        "line1": f"2*k1**-1*{_GAP}.T*(k1*Pi*norm(bhat) - k2*ahat)",
        "line2": f"2*{_GAP}.T*Pi*norm(bhat) - 2*k1**-1*{_GAP}.T*k2*ahat",
        "line3": f"2*{_GAP}.T*Pi*norm(bhat) - 2*k1**-1*k2*{_GAP}.T*(ahat - alpha + alpha)",
        "line4": f"2*{_GAP}.T*Pi*norm(bhat) - 2*k1**-1*k2*{_GAP}.T*{_GAP}"
        f" - 2*k1**-1*k2*{_GAP}.T*alpha",
        "line5": f"2*{_GAP}.T*Pi*norm(bhat) - 2*k1**-1*k2*norm{_GAP}**2"
        f" + 2*k1**-1*k2*norm{_GAP}*norm(alpha)",
    },
    41: {
        "line1": f"{_DECAY} + epsilon/2 - 2*k1**-1*k2*norm{_GAP}**2"
        f" + 2*k1**-1*k2*norm{_GAP}*norm(alpha)",
        "line2": "-K1*norm(delta)**2 + K2*norm(delta) + K3",
        "square": f"norm(beta)**2 + norm{_GAP}**2",
    },
    42: {
        "K1": "Min(2*kappa*lower*(1 + rho), 2*k1**-1*k2*(1 + rho))",
        "K2": "2*k1**-1*k2*(1 + rho)*norm(alpha)",
        "K3": "(1 + rho)*epsilon/2",
    },
    43: {
        "R": "1/(2*K1)*(K2 + sqrt(K2**2 + 4*K1*K3))",
        "R_transcribed": "1/(2*K1)*(K2/K2 + sqrt((K2**2 + 4*K1*K3)/K1))",
        "within": "sqrt(gM/gm)*R",
        "beyond": "sqrt(gM/gm)*r",
    },
    44: {
        "gm": "Min(eigenvalue(P), 2*K1**-1*(1 + rho))",
        "gM": "Max(eigenvalue(P), 2*K1**-1*(1 + rho))",
    },
    45: {"d_under": "sqrt(gM/gm)*R"},
    46: {
        "edge": "d_bar*sqrt(gm/gM)",
        "T": "(gM*r**2 - (gm**2/gM)*d_bar**2)/(K1*d_bar**2*(gm/gM) - K2*d_bar*sqrt(gm/gM) - K3)",
    },
    47: {"Pi": "(norm(dq) + 1)**2 + (norm(e) + 1)**2"},
    48: {
        "Pi": "(norm(dq) + 1)**2 + (norm(e) + 1)**2",
        "factor": f"theta2/{_DET}",
        "braces": "lam*(dq1 - dq10) + lam*lam1*(q1 - q10) + (dq2 - dq20) + lam2*(q2 - q20)"
        " + sigma*lam*(q1 - q10) + sigma*lam*lam1*integral(q1 - pi/2) + sigma*(q2 - q20)"
        f" + sigma*lam2*integral(q2) + {_SUM}",
        "rate": "k1*Pi*norm(factor*braces) - k2*ahat",
    },
}

_FRICTION = "4.18*(tanh(1.59*rate) - tanh(3.15*rate)) + 0.09*tanh(3.52*rate) + 0.021*rate"

#: Values with their printed units, and what the text says, by where it stands.
SAID: Mapping[str, Mapping[str, str]] = {
    "plant of section 5": {
        "m1": "0.09 kg",
        "m2": "0.73 kg",
        "l1": "0.15 m",
        "lc1": "0.09 m",
        "lc2": "0.08 m",
        "I1": "0.0073 kg*m^2",
        "I2": "0.0001 kg*m^2",
        "g": "9.8 kg/m^2",
    },
    "gains of section 5.1": {"lam": "2.25", "lam1": "0.55", "lam2": "0.7"},
    "start of section 5": {"q1": "1 rad", "q2": "0.5 rad", "dq1": "1 rad/s", "dq2": "0 rad/s"},
    "plant of section 6": {
        "theta1": "0.0096 kg*m^2",
        "theta2": "0.0054 kg*m^2",
        "theta3": "0.0046 kg*m^2",
        "theta4": "0.0679 kg*m^2",
        "theta5": "0.0332 kg*m^2",
        "g": "9.8 m/s^2",
    },
    "friction of section 5.2": {"f": _FRICTION, "source": "[19]"},
    "friction of section 5.3": {"f": _FRICTION, "source": "[16]"},
    "IAE of section 5.1": {"q1": "t_f", "q2": "t"},
    # Every statement that has a heading of its own, and every one that the text announces.
    "statements": {
        "Assumption 1": "3.2",
        "Assumption 2": "3.2",
        "Theorem 1": "4",
        **{f"Remark {k}": s for k, s in enumerate(("2.2", "3.2", "3.2", "3.2", "3.2"), 1)},
    },
    "announcements": {
        "Lemma": "2.2, before (2)",
        "Assumption": "3.2, before (13)",
        "Theorem": "3.2, remark 3",
    },
}

PAPER = Paper(EQUATIONS, SAID)
