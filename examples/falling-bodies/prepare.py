"""Unpacks the wheels beside this file into `site`."""

import glob
import os
import sys
import zipfile

here = os.path.dirname(os.path.abspath(__file__))
wheels = sorted(glob.glob(os.path.join(here, "wheels", "*.whl")))
if not wheels:
    sys.exit("there is no wheel: run ./get-wheels")
for wheel in wheels:
    zipfile.ZipFile(wheel).extractall(os.path.join(here, "site"))
print(f"Python {sys.version.split()[0]}, {len(wheels)} wheels")
