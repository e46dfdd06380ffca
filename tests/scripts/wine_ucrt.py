"""Gives Wine 10's ucrtbase.dll the complex accessors that it lacks and NumPy calls at import: `wine_ucrt.py FILE`."""

import sys
from pathlib import Path

import pefile

STUB = "4883ec28"
"""What a function begins with that Wine does not have."""
CODE = {
    "crealf": "660f6ec1c3",  # a struct of two floats is in rcx
    "cimagf": "48c1e920660f6ec1c3",
    "cimag": "f20f104108c3",  # a pointer to two doubles is in rcx
    "cimagl": "f20f104108c3",
    "creall": "f20f1001c3",
    "_FCbuild": "660f7ec0660f7ec948c1e1204809c8c3",  # two floats in xmm0 and xmm1 become one number in rax
}

path = Path(sys.argv[1])
library = pefile.PE(path)
image, data = library.get_memory_mapped_image(), bytearray(path.read_bytes())
for export in library.DIRECTORY_ENTRY_EXPORT.symbols:
    name = (export.name or b"").decode()
    if name in CODE and image[export.address : export.address + 4].hex() == STUB:
        code, place = bytes.fromhex(CODE[name]), library.get_offset_from_rva(export.address)
        data[place : place + len(code)] = code
path.write_bytes(data)
