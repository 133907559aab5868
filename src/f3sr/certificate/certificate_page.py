"""certificate.html: one page, without a network, in the style of the report's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import f3sr
from f3sr.certificate.certificate_document import Certificate
from f3sr.certificate.clients_table import CLIENTS
from f3sr.report_page.formatting import counted, length, listed, number
from f3sr.web.document import WEB, document

HERE = Path(__file__).parent
MEANINGS = {
    "rests": "it stays within the limits",
    "rolls": "it is round and leaves its place at about its height",
    "moves": "it leaves its place",
    "differs": "the engine has another mass or inertia",
    "lost": "its pose is no number",
}


def certificate_page(certificate: Certificate) -> bytes:
    """The page of a certificate: every engine with every object, every validator, and who was not asked or gave no
    answer."""
    asked = [row for row in certificate.engines if row.objects]
    rows = (*certificate.engines, *certificate.validators)
    silent = [row for row in rows if row.reason]
    names = {row.client.name for row in rows}
    return document(
        HERE / "templates" / "certificate.html",
        {
            "certificate": certificate,
            "version": f3sr.__version__,
            "engines": asked,
            "validators": [row for row in certificate.validators if not row.reason],
            "silent": silent,
            "unasked": [client for client in CLIENTS.values() if client.name not in names],
            "meanings": MEANINGS,
            "degrees": _degrees,
            "counted": counted,
            "length": length,
            "listed": listed,
            "number": number,
        },
        styles=(WEB / "page.css", HERE / "certificate.css"),
        scripts=(),
    )


def _degrees(radians: float) -> str:
    """Degrees, with two digits."""
    value = float(np.degrees(radians))
    return "< 0.01°" if 0 < value < 0.01 else f"{number(value, digits=2)}°"
