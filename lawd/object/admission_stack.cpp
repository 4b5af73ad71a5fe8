// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/admission_lines.hpp"

#include <algorithm>
#include <charconv>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "lawd/run/child.hpp"
#include "lawd/run/files.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

constexpr std::uint64_t kMaxFrameBytes = 16u << 10, kMaxStackBytes = 64u << 10;
constexpr std::uint64_t kLibraryFrameBytes = 1024;  // assumed for a function of <cmath>: its call graph is not known
constexpr std::uint64_t kLibraryDepth = 64;
constexpr const char* kGate = "stack";

struct Node {
  std::string name;  // readable
  int line = 0;      // of the law; 0 = a header's
  std::uint64_t frame_bytes = 0;
  bool known = false;  // its body is in this object
  bool dynamic = false;
  std::vector<std::size_t> calls;
  std::vector<int> call_lines;
};

// The value of `key: "..."` in a line of the graph.
std::string_view field(std::string_view line, std::string_view key) {
  const std::string opening = std::string(key) + ": \"";
  const auto from = line.find(opening);
  if (from == std::string_view::npos) return "";
  const std::string_view rest = line.substr(from + opening.size());
  return rest.substr(0, rest.find('"'));
}

class Graph {
 public:
  Graph(std::string_view text, const SourceLines& lines) : lines_(lines) {
    for (const std::string_view line : lines_in(text)) read_line(line);
  }

  const std::vector<Node>& nodes() const { return nodes_; }

 private:
  std::size_t index(std::string_view title) {
    const auto [place, is_new] = names_.try_emplace(std::string(title), nodes_.size());
    if (is_new) name(nodes_.emplace_back(), title.substr(title.rfind(':') + 1));
    return place->second;
  }

  void read_line(std::string_view line) {
    if (line.starts_with("node:")) {
      read_node(line);
    } else if (line.starts_with("edge:")) {
      const std::size_t from = index(field(line, "sourcename")), to = index(field(line, "targetname"));
      nodes_[from].calls.push_back(to);
      nodes_[from].call_lines.push_back(lines_.own_line(field(line, "label")));
    }
  }

  // title: "file:symbol", or the symbol.
  // label: "name\nfile:line:column\nN bytes (static|dynamic|dynamic,bounded)\n..."; when g++ split a function, the name
  // in the label is not that of the function.
  void read_node(std::string_view line) {
    Node& node = nodes_[index(field(line, "title"))];
    std::string_view label = field(line, "label");
    for (int part = 0; !label.empty(); ++part) {
      const std::size_t end = std::min(label.find("\\n"), label.size());
      const std::string_view text = label.substr(0, end);
      label.remove_prefix(std::min(end + 2, label.size()));
      if (part == 1) {
        if (const int own = lines_.own_line(text)) node.line = own;
      } else if (text.find(" bytes (") != std::string_view::npos) {
        node.known = true;
        node.dynamic = text.find("dynamic)") != std::string_view::npos;
        std::from_chars(text.data(), text.data() + text.size(), node.frame_bytes);
      }
    }
  }

  // When `step` was inlined, the contract's wrapper has its stack frame.
  void name(Node& node, std::string_view symbol) {
    node.name = readable(symbol);
    node.name.resize(std::min(node.name.size(), node.name.find(" [clone")));
    if (!has_text(node.name, "lithe::contract::")) return;
    const bool init = has_text(node.name, "::init<");
    node.name = init ? "init()" : "step()";
    node.line = lines_.mentions(init ? "init" : "step");
  }

  const SourceLines& lines_;
  std::map<std::string, std::size_t> names_;
  std::vector<Node> nodes_;
};

class Depth {
 public:
  Depth(const Graph& graph, Admission& out) : nodes_(graph.nodes()), out_(out), state_(nodes_.size()) {}

  std::uint64_t deepest() {
    std::uint64_t most = 0;
    for (std::size_t i = 0; i < nodes_.size(); ++i) most = std::max(most, below(i));
    return most;
  }

 private:
  enum class Seen { no, open, done };
  struct State {
    Seen seen = Seen::no;
    std::uint64_t bytes = 0;
  };

  // Stack of node i with everything it calls [bytes]. Very deep graphs are cut off: they exceed the limit anyway.
  std::uint64_t below(std::size_t i) {
    State& state = state_[i];
    if (state.seen == Seen::done) return state.bytes;
    state.seen = Seen::open;
    path_.push_back(i);
    const Node& node = nodes_[i];
    std::uint64_t most = 0, times = 1;
    for (std::size_t k = 0; k < node.calls.size() && path_.size() < 1000; ++k) {
      const std::size_t to = node.calls[k];
      if (nodes_[to].name == "Indirect Call Placeholder" || nodes_[to].name == "__indirect_call") {
        refuse_indirect(node, node.call_lines[k]);
      } else if (state_[to].seen == Seen::open) {
        if (refuse_recursion(to, node.call_lines[k])) continue;
        times = kLibraryDepth;
      } else {
        most = std::max(most, below(to));
      }
    }
    path_.pop_back();
    state.seen = Seen::done;
    state.bytes = most + times * (node.known ? node.frame_bytes : kLibraryFrameBytes);
    return state.bytes;
  }

  void refuse_indirect(const Node& node, int line) {
    out_.refuse(kGate,
                node.name + " calls a function through a pointer: call it by its name, or choose with if or switch",
                line != 0 ? line : node.line);
  }

  // False when every function of the cycle is from the library.
  bool refuse_recursion(std::size_t to, int line) {
    const auto from = std::ranges::find(path_, to);
    for (auto step = from; step != path_.end(); ++step) {
      const Node& node = nodes_[*step];
      if (node.line == 0) continue;
      out_.refuse(kGate,
                  node.name +
                      " calls itself, directly or through others: its stack has no bound, write a loop with a fixed "
                      "number of turns",
                  line != 0 ? line : node.line);
      return true;
    }
    return false;
  }

  const std::vector<Node>& nodes_;
  Admission& out_;
  std::vector<State> state_;
  std::vector<std::size_t> path_;
};

void check_frames(const Graph& graph, Admission& out) {
  for (const Node& node : graph.nodes()) {
    if (node.dynamic) {
      out.refuse(kGate,
                 node.name +
                     " has a stack frame whose size depends on its input (an array of variable length, alloca): use a "
                     "std::array of fixed size",
                 node.line);
    } else if (node.frame_bytes > kMaxFrameBytes) {
      out.refuse(kGate,
                 node.name + " needs " + std::to_string(node.frame_bytes) + " bytes of stack; at most " +
                     std::to_string(kMaxFrameBytes) + ": put large arrays into State, or use smaller ones",
                 node.line);
    }
  }
}

}  // namespace

void check_stack(const Compiled& compiled, const SourceLines& lines, Admission& out) {
  out.apply(kGate, [&]() -> std::string {
    const std::size_t before = out.findings.size();
    const auto text = read_file(compiled.object_path.substr(0, compiled.object_path.rfind('.')) + ".ci");
    const Graph graph(text.value_or(""), lines);
    if (graph.nodes().empty())
      return out.not_applied = "the compiler wrote no call graph: how deep the stack gets is not known";
    check_frames(graph, out);
    const std::uint64_t bytes = Depth(graph, out).deepest();
    if (out.findings.size() == before && bytes > kMaxStackBytes) {
      out.refuse(kGate, "the law needs " + std::to_string(bytes) + " bytes of stack along its deepest calls; at most " +
                            std::to_string(kMaxStackBytes) + ": put large arrays into State, or use smaller ones");
    }
    return std::to_string(bytes) + " bytes";
  });
}

}  // namespace lithe::lawd
