"""Generators of the reference pages and of the documentation site; not part of the wheel.

``python -m docs.make`` writes files.md, python.md and commands.md in docs/reference, ``make docs``
the site. The tests that name what is missing are tests/test_reference_files.py,
tests/test_reference_python.py and tests/test_docs_site.py.

- A new key of a known file: its line in ``keys.toml``. Where no shipped file has the key, one in
  ``examples/FOLDER`` that has it.
- A new kind of file read through `rigs.rigfile.toml_reader.Table`: a folder below ``examples``, its
  kind in `docs.make.readers.FOLDERS`, its reader in `docs.make.readers.recorded`, its title in
  `docs.make.kinds.KINDS`. What a user names in it (NAME) goes into `docs.make.readers.NAMES`.
- A new kind of file read as plain tables: an entry in `docs.make.stated.plain_kinds`.
- A new page: a row in a table of docs/README.md; the sidebar follows.
"""
