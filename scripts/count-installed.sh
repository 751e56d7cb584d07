#!/bin/bash
# count-installed.sh UV VENV LOCK: how far `uv pip sync` of a lock file's libraries into a new environment is.
uv=$1 venv=$2 lock=$3
of=$(grep '^[A-Za-z0-9].*==' "$lock" | grep -vc "sys_platform == 'win32'")
libraries=("$venv"/lib/python3*/site-packages)
installed=$(find "${libraries[@]}" -maxdepth 1 -name '*.dist-info' | wc -l)
if [ "$installed" -ge "$of" ]; then
	echo "$of installed, $(find "${libraries[@]}" -name '*.pyc' | wc -l) files of byte code"
elif [ "$installed" -gt 0 ]; then
	echo "$installed of $of installed"
else
	# Each is unpacked into a folder of uv's cache.
	echo "$(find "$("$uv" cache dir)/archive-v0" -mindepth 1 -maxdepth 1 -newer "$venv/pyvenv.cfg" | wc -l) of $of fetched"
fi
