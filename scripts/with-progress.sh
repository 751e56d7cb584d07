#!/bin/bash
# with-progress.sh TEXT COUNT COMMAND...: runs a command that says nothing. TEXT is shown at once, then what the shell
# command COUNT prints ("": nothing) and the seconds: on a terminal in a line that is overwritten, elsewhere in a
# line now and then. The exit code is the command's.
text=$1 count=$2
shift 2
period=1
if [ -t 2 ]; then begin=$'\r\e[K' end=; else begin= end=$'\n'; fi

show() {
	local counted=
	[ -z "$1" ] || counted=$(eval "$count" 2>/dev/null)
	printf '%s%s%s%s%s' "$begin" "$text" "${counted:+: $counted}" "$1" "$end" >&2
}

# It ends with this script, also if that is killed.
tell() {
	local start=$SECONDS
	while read -r -t $period <&3; [ $? -gt 128 ] && kill -0 $$ 2>/dev/null; do
		show ", $((SECONDS - start)) s"
	done
}

show ""
# Nothing is ever written to this pipe: reading it is a sleep that starts no process.
exec 3<> <(:)
tell >/dev/null &
teller=$!
trap 'kill $teller 2>/dev/null; wait $teller 2>/dev/null; [ -z "$begin" ] || printf %s "$begin" >&2' EXIT
"$@" 3>&-
