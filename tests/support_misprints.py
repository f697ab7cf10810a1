"""One misprint a row of the audit, and more: (number, what is printed, what is printed instead)."""

import re
from collections.abc import Iterator

#: Of a row that differs as printed the misprint is the right form, or spoils what holds in it.
MISPRINTS = (
    (1, "2*theta3*cos(q2)", "theta3*cos(q2)"),
    (1, "-theta3*dq2,", "theta3*dq2,"),
    (1, "theta5*g*cos(q1 + q2)], [", "theta5*g*cos(q1)], ["),
    (1, "M*ddq + C*dq + G + F", "M*ddq + C*dq + G - F"),
    (1, "m2*l1*lc2", "m2*lc1*lc2"),
    (2, "-(2*eta/pi)*atan(s)", "-(eta/pi)*atan(s)"),
    (2, "ds + sigma*s", "ds - sigma*s"),
    (2, "eta", "0", "limit"),
    (3, "lam1*e1", "lam2*e1"),
    (3, "+ (de2", "- (de2"),
    (4, "q1 - q1d", "q1 + q1d"),
    (4, "pi/2", "-pi/2"),
    (5, "lam*lam1*(q1 - pi/2) + dq2 + lam2*q2)", "lam*lam1*q1 + dq2 + lam2*q2)"),
    (5, "lam*ddq1", "ddq1"),
    (6, "lam*(dq1 - dq10)", "lam*(dq1 + dq10)"),
    (6, "sigma*lam2*integral(q2)", "sigma*lam*integral(q2)"),
    (6, "-(2*eta/pi)", "(2*eta/pi)"),
    (7, "rows([lam, 1])", "rows([1, lam])"),
    (7, "-lam*lam1*dq1 - lam2*dq2", "-lam*lam1*dq1 + lam2*dq2"),
    (7, "lam*dq10 - lam*lam1", "lam*dq10 + lam*lam1"),
    (7, "- sigma*lam2*integral(q2)", "+ sigma*lam2*integral(q2)"),
    (8, "A*dq - c", "A*dq + c"),
    (8, "A*ddq - b", "A*ddq + b"),
    (9, "B*Fhat + dF", "B*Fhat - dF"),
    (9, "B.T*dF", "A*D*dF"),
    (10, "lam*theta2/", "((lam - 1)*theta2 - theta3*cos(q2))/"),
    (11, "(A*D*B)**-1*A*D*F", "(A*D*B)**-1*A*F"),
    (11, "F - B*Fhat", "F + B*Fhat"),
    (12, "A*D*dF", "A*dF"),
    (13, "A*D*B*B.T*D*A.T", "A*D*A.T"),
    (14, "norm(Fhat)", "norm(B.T*F)"),
    (15, "- k2*ahat", "+ k2*ahat"),
    (15, "k1*Pi*norm(bhat)", "k1*Pi*bhat"),
    (16, "p2 + p3", "p2 - p3"),
    (17, "b + A*D", "b - A*D"),
    (17, "C*dq + G", "C*dq - G"),
    (18, "-kappa*bhat", "kappa*bhat"),
    (19, "-gamma*mu", "-mu"),
    (20, "B.T*D*A.T", "B.T*A.T"),
    (21, "A*dq - c", "A*dq + c"),
    (22, "bhat*ahat.T", "bhat*alpha.T"),
    (23, "1/norm(mu)", "1/norm(mu)**2"),
    (23, "1/epsilon", "2/epsilon"),
    (23, "norm(mu) - epsilon", "epsilon - norm(mu)"),
    (24, "+ k1**-1", "- k1**-1"),
    (24, "k1**-1", "k1"),
    (24, "beta.T*beta", "2*beta.T*beta"),
    (25, "2*k1**-1", "k1**-1"),
    (26, "(-C*dq - G - F)", "(-C*dq - G + F)"),
    (26, "A*ddq - b", "A*ddq + b"),
    (26, "- F + B*p3", "- F - B*p3"),
    (27, "-C*dq - G", "-C*dq + G"),
    (27, "B*p1) - b", "B*p1) + b"),
    (28, "+ A*D*dF", "+ A*dF"),
    (28, "A*D*B*Fhat + 0", "A*D*B*Fhat + 1"),
    (29, "-2*beta.T*A*D*B*Fhat", "2*beta.T*A*D*B*Fhat"),
    (29, "2*beta.T*A*D*B*p3", "beta.T*A*D*B*p3"),
    (30, "2*norm(B.T*D*A.T*beta)", "norm(B.T*D*A.T*beta)"),
    (30, "2*norm(bhat)", "norm(bhat)"),
    (31, "(-kappa*B.T", "(kappa*B.T"),
    (32, "-2*kappa*lower", "-3*kappa*lower"),
    (32, "-2*kappa*beta.T", "-kappa*beta.T"),
    (33, "-2*kappa*lower", "-3*kappa*lower"),
    (34, "-2*gamma*norm(mu)**2", "2*gamma*norm(mu)**2"),
    (34, "-gamma*mu", "-mu"),
    (35, "-2*norm(mu)", "-norm(mu)"),
    (35, "norm(mu)**2", "norm(mu)**3"),
    (36, "/epsilon", "/epsilon**2"),
    (36, "-2*norm(mu)**2/epsilon", "-2*norm(mu)/epsilon"),
    (37, "- 2*norm(mu)", "- 3*norm(mu)"),
    (37, "- 2*norm(bhat)*ahat.T*Pi", "- norm(bhat)*ahat.T*Pi"),
    (37, "(alpha - ahat)", "(ahat - alpha)"),
    (38, "2*(1/(4/epsilon))", "2*(1/(8/epsilon))"),
    (38, "- 2*norm(mu)**2/epsilon + 2*norm(bhat)*alpha.T*Pi", "- 3*norm(mu)**2/epsilon", "line1"),
    (38, "norm(mu)**2/epsilon - norm(mu)", "norm(mu)**2/epsilon + norm(mu)"),
    (39, "epsilon/2", "epsilon/4"),
    (39, "-2*kappa*lower", "-3*kappa*lower"),
    (40, "norm(ahat - alpha)**2", "norm(ahat - alpha)"),
    (40, "+ 2*k1**-1*k2*norm(ahat - alpha)*norm(alpha)", ""),
    (41, "epsilon/2", "epsilon/4"),
    (41, "+ K3", "- K3"),
    (41, "norm(beta)**2 +", "norm(beta)**2 -"),
    (42, "(1 + rho)", "1"),
    (43, "4*K1*K3))", "4*K1))"),
    (43, "sqrt(gM/gm)*R", "sqrt(gm/gM)*R"),
    (43, "sqrt(gM/gm)*r", "sqrt(gM)*r"),
    (44, "2*K1**-1*(1 + rho)", "1/k1"),
    (45, "sqrt(gM/gm)", "sqrt(gm/gM)"),
    (45, "sqrt(gM/gm)", "gM/gm"),
    (46, "gM*r**2", "gm*r**2"),
    (46, "- K3)", "+ K3)"),
    (46, "d_bar*sqrt(gm/gM)", "d_bar*sqrt(gM/gm)", "edge"),
    (47, "norm(e) + 1", "norm(e)"),
    (47, "norm(dq) + 1)**2", "norm(dq) + 1)**3"),
    (48, "theta2/", "((lam - 1)*theta2 - theta3*cos(q2))/"),
)

#: What a symbol is taken for in a mechanical misprint.
_TAKEN_FOR = {
    **{f"{name}1": f"{name}2" for name in ("q", "dq", "ddq", "e", "de", "lam")},
    **{f"{name}2": f"{name}1" for name in ("q", "dq", "ddq", "e", "de", "lam")},
    **{"q10": "q20", "q20": "q10", "dq10": "dq20", "dq20": "dq10"},
    **{"theta1": "theta2", "theta2": "theta1", "theta3": "theta1", "cos": "sin", "sin": "cos"},
    **{"k1": "k2", "k2": "k1", "kappa": "k1", "epsilon": "kappa", "lower": "kappa"},
    **{"lam": "lam1", "sigma": "lam1", "eta": "sigma", "alpha": "ahat", "ahat": "alpha"},
    **{"p1": "p2", "p2": "p3", "p3": "p1", "mu": "bhat", "bhat": "mu", "beta": "dbeta"},
    **{"dbeta": "beta", "Fhat": "dF", "D": "M", "F": "G", "G": "F", "C": "M"},
}
_SIGN = re.compile(r"(?<= )[-+](?= )|^-|(?<=\()-")
_NUMBER = re.compile(r"(?<![\w.])\d+(?![\w.])")
_NAME = re.compile(r"[A-Za-z_]\w*")
#: Rows of which every sign, number and symbol was tried; the first are cheap.
CHEAP = (2, 3, 9, 12, 16, 18, 19, 22, 25, 31)
SEEN_WHOLE = (*CHEAP, 4, 5, 6, 7, 8, 11, 15, 17, 20, 21, 23, 24, 27, 28, 30, 32, 33, 34, 35, 36, 37)
#: Changes that leave a true statement: q2d is 0, A D dF is 0, and weaker bounds.
TRUE_STILL = {
    (4, "q2 + q2d"),
    (28, "A*D*B*Fhat - A*D*dF"),
    (28, "A*D*B*Fhat - 0"),
    (30, "3*norm(bhat)*alpha.T*Pi"),
}


def changes(text: str) -> Iterator[str]:
    """Yield `text` with a sign turned, a number raised by one, a symbol taken for another."""
    for found in _SIGN.finditer(text):
        inner = found.start() and text[found.start() - 1] == " "
        turned = {"+": "-", "-": "+"}[found[0]] if inner else ""
        yield text[: found.start()] + turned + text[found.end() :]
    for found in _NUMBER.finditer(text):
        yield text[: found.start()] + str(int(found[0]) + 1) + text[found.end() :]
    for found in _NAME.finditer(text):
        if found[0] in _TAKEN_FOR:
            yield text[: found.start()] + _TAKEN_FOR[found[0]] + text[found.end() :]
