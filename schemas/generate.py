"""Generate the committed protobuf modules from the schema: ``python schemas/generate.py [OUT]``."""

import sys
from pathlib import Path

from grpc_tools import protoc

SCHEMAS = Path(__file__).parent


def generate(out: Path) -> None:
    """Write ``spoofbench/schema/v1/*_pb2.py`` and ``*_pb2.pyi`` below ``out``."""
    files = sorted(str(path) for path in SCHEMAS.glob("spoofbench/schema/v1/*.proto"))
    if protoc.main(["protoc", f"-I{SCHEMAS}", f"--python_out={out}", f"--pyi_out={out}", *files]):
        raise SystemExit("protoc failed")


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else SCHEMAS.parent / "src")
