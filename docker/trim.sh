#!/bin/sh
# Removes from a site-packages folder what no service needs at run time. Half of what pip installs
# here is debug symbols, sample data, headers and other packages' tests.
set -eu
cd "$1"

# Robots and textures for PyBullet's examples, and the examples.
rm -rf pybullet_data pybullet_envs pybullet_examples pybullet_robots pybullet_utils
rm -rf eglRenderer.*.so

# Rerun uses Arrow only for columns in memory: no network, no object stores, no headers.
rm -rf pyarrow/include pyarrow/src pyarrow/tests pyarrow/libarrow_flight.* \
  pyarrow/libarrow_python_flight.* pyarrow/_flight.* pyarrow/libarrow_s3.* \
  pyarrow/libarrow_python_parquet_encryption.* pyarrow/_pyarrow_cpp_tests.* \
  pyarrow/_azurefs.* pyarrow/_gcsfs.* pyarrow/_hdfs.* pyarrow/_s3fs.* pyarrow/_orc.* \
  pyarrow/_parquet*.so pyarrow/_dataset*.so pyarrow/_substrait.*
# Each library exists under three names, and only one is used.
rm -f pyarrow/libarrow_python.so pyarrow/libarrow_python.so.*.*

# rosbags is used only for message types and serialization, not for its readers and writers of bags.
rm -rf apsw ruamel

# Of the notebook package only the viewer for browsers is used, which the console sends compressed.
rm -f rerun_notebook/asset_server.py rerun_notebook/error_widget.js rerun_notebook/static/widget.css
gzip -9 -n rerun_notebook/static/re_viewer_bg.wasm rerun_notebook/static/widget.js

rm -rf foxglove/tests foxglove/benchmarks foxglove/notebook

# scipy is used for distances, neighbours, graphs and optimisation.
rm -rf scipy/stats scipy/io scipy/signal scipy/integrate scipy/interpolate
find pyarrow -name '*.pxi' -delete -o -name '*.pxd' -delete -o -name '*.pyx' -delete

find networkx numba numpy scipy shapely -type d -name tests -prune -exec rm -rf {} +
find . -name '*.pyi' -delete

# Only these: a wheel's bundled libraries have been rewritten by auditwheel, which strip may break.
strip --strip-unneeded pybullet.*.so foxglove/*.so rerun_bindings/*.so llvmlite/binding/*.so zenoh/*.so
if [ -e rerun_cli/rerun ]; then strip --strip-unneeded rerun_cli/rerun; fi

# The remaining packages must still import.
cd /
"$1/../../../bin/python" -c '
import collada, cv2, foxglove.websocket, jinja2, lxml.etree, lz4.frame, moderngl, networkx, numba, PIL.Image, pybullet
import pydantic_settings, rerun, rosbags.typesys, scipy.ndimage, scipy.sparse.csgraph
import scipy.optimize, scipy.spatial, shapely, starlette, trimesh, typer, uvicorn
import websockets, xacro, zenoh
'
