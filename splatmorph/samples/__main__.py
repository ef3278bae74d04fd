"""``python -m splatmorph.samples FOLDER`` writes the sample pair there."""

import sys

from splatmorph.samples import write_sample_pair

if len(sys.argv) != 2:
    raise SystemExit("usage: python -m splatmorph.samples FOLDER")
write_sample_pair(sys.argv[1])
