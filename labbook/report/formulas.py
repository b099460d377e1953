"""Formulas as MathML, which browsers draw by themselves, from the plain notation in which laws state them."""

import re
from html import escape

_TOKEN = re.compile(r"\s*([A-Za-zφτγδσμρ]+(?:_[A-Za-z0-9∞]+)?'?|\d+(?:\.\d+)?|[-+*/^()=,;])")
_GREEK = {
    "alpha": "α",
    "gamma": "γ",
    "delta": "δ",
    "epsilon": "ε",
    "kappa": "κ",
    "phi": "φ",
    "rho": "ρ",
    "sigma": "σ",
    "tau": "τ",
    "mu": "μ",
    "inf": "∞",
}
_FUNCTIONS = {"exp", "log", "ln", "sin", "cos", "tan"}


def mathml(text: str) -> str:
    """A `math` element of `W = C rho_b sqrt(g) (D - k d)^(3/2) Z`, whose alternative text is the notation itself.

    Names of letters, subscripts after `_`, powers `^2` or `^(3/2)`, roots `sqrt(...)` and the usual functions; several
    formulas are parted by commas or semicolons. What cannot be read so is returned as plain text, escaped.
    """
    try:
        body = _Reader(_tokens(text)).formulas()
    except ValueError:
        return escape(text)
    return f'<math alttext="{escape(text)}">{body}</math>'


def _tokens(text: str) -> list[str]:
    tokens, offset = [], 0
    text = text.rstrip()
    while offset < len(text):
        match = _TOKEN.match(text, offset)
        if match is None:
            raise ValueError(text[offset:])
        tokens.append(match[1])
        offset = match.end()
    return tokens


class _Reader:
    """Reads tokens from left to right; ValueError at what it does not know."""

    def __init__(self, tokens: list[str]):
        self._left = tokens[::-1]

    def formulas(self) -> str:
        """All tokens."""
        parts = self._until("")
        return f"<mrow>{parts}</mrow>"

    def _until(self, end: str) -> str:
        """MathML of the items up to the token `end`, which is consumed, or up to the last if `end` is empty."""
        parts: list[str] = []
        while self._left:
            token = self._left.pop()
            if token == end:
                return "".join(parts)
            if token == "-" and not parts:  # a sign, without the room that is left about a difference
                parts.append('<mo form="prefix">−</mo>')
                continue
            if token == ")":
                raise ValueError("a bracket is closed that was not opened")
            parts.append(self._powered(self._item(token)))
        if end:
            raise ValueError(f"{end} is missing")
        return "".join(parts)

    def _powered(self, base: str) -> str:
        if not self._left or self._left[-1] != "^":
            return base
        self._left.pop()
        if not self._left:
            raise ValueError("a power is missing")
        token = self._left.pop()
        power = self._until(")") if token == "(" else self._item(token)
        return f"<msup>{base}<mrow>{power}</mrow></msup>"

    def _item(self, token: str) -> str:
        if token == "sqrt":
            return f"<msqrt>{self._bracket()}</msqrt>"
        if token == "(":
            return f"<mrow><mo>(</mo>{self._until(')')}<mo>)</mo></mrow>"
        if token in "-+*/=^,;":
            sign = {"-": "−", "*": "·"}.get(token, token)
            space = ' rspace="1em"' if token in ",;" else ""
            return f"<mo{space}>{sign}</mo>"
        if token[0].isdigit():
            return f"<mn>{token}</mn>"
        if token in _FUNCTIONS:
            return f'<mi>{token}</mi><mo rspace="0">&#8289;</mo>'
        return _letter(token)

    def _bracket(self) -> str:
        if not self._left or self._left.pop() != "(":
            raise ValueError("a bracket is missing")
        return self._until(")")


def _letter(token: str) -> str:
    prime, token = token.endswith("'"), token.removesuffix("'")
    name, _, below = token.partition("_")
    symbol = f"<mi>{_GREEK.get(name, name)}</mi>"
    if below:
        index = _GREEK.get(below, below)
        kind = "mn" if index.isdigit() else "mi"
        symbol = f"<msub>{symbol}<{kind}>{index}</{kind}></msub>"
    return f"<msup>{symbol}<mo>′</mo></msup>" if prime else symbol
