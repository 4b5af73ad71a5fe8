// SPDX-License-Identifier: Apache-2.0
// Variables of the environment; paths and names of sockets, shared memory and compiled laws.
#pragma once

#include <string>
#include <string_view>

namespace lithe {

// A variable of the environment; one that is set to nothing is like one that is not set.
std::string environment(const char* name);

// The folder of this program; the others of LITHE are in the same one, what it is installed with beside it.
std::string program_dir();

// $LITHE_RUN_DIR, else /run/lithe (root), else $XDG_RUNTIME_DIR/lithe, else /tmp/lithe-<uid>. Not created.
std::string run_dir();

// $LITHE_CACHE_DIR, else $XDG_CACHE_HOME/lithe, else $HOME/.cache/lithe, else <run_dir>/cache. Not created.
std::string cache_dir();

// $LITHE_OUT_DIR, else "out" below the working directory: results, one folder per robot. Not created.
std::string out_dir();

// Control socket of a robot: <run_dir>/<robot>.sock
std::string control_socket_path(std::string_view robot);

// Shared-memory object of a robot: /dev/shm/<prefix>.<robot>.<segment>, prefix $LITHE_SHM_PREFIX or "lithe".
std::string shm_path(std::string_view robot, std::string_view segment);

}  // namespace lithe
