"""Edits: what a user changes in a scene, brought to rest and measured again (docs: editing)."""

from f3sr.edits.edit_list import Edit, edit_of, edits_json, read_edits
from f3sr.edits.edit_session import EditOutcome, EditSession
from f3sr.edits.edited_files import deliver_edited, edited_document, edited_files, write_edited

__all__ = [
    "Edit",
    "EditOutcome",
    "EditSession",
    "deliver_edited",
    "edit_of",
    "edited_document",
    "edited_files",
    "edits_json",
    "read_edits",
    "write_edited",
]
