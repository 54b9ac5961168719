// SPDX-License-Identifier: Apache-2.0
/// @file Pose graphs in g2o's text format: lines VERTEX_SE3:QUAT id x y z qx qy qz qw;
/// EDGE_SE3:QUAT id id, the same seven numbers and the upper triangle of the information matrix by
/// rows, translation first; FIX id.
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <istream>
#include <locale>
#include <ostream>
#include <sstream>
#include <string>
#include <system_error>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/errors.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Reads lines of g2o's format.
class g2o_reader {
public:
  pose_graph read(std::istream& in) {
    std::string text;
    while (std::getline(in, text)) {
      ++line_;
      std::istringstream words(text);
      words.imbue(std::locale::classic());
      std::string tag;
      if (!(words >> tag) || tag[0] == '#') { continue; }
      if (tag == "VERTEX_SE3:QUAT") {
        read_vertex(words);
      } else if (tag == "EDGE_SE3:QUAT") {
        read_edge(words);
      } else if (tag == "FIX") {
        read_fixed(words);
      } else {
        refuse("there is '" + tag + "', which is not VERTEX_SE3:QUAT, EDGE_SE3:QUAT or FIX");
      }
    }
    if (in.bad()) { throw error("ft: pose graph: cannot be read"); }
    resolve();
    return std::move(graph_);
  }

private:
  struct edge_ids {
    std::int64_t from, to;
    int line;
  };

  [[noreturn]] void refuse(std::string const& what) const {
    throw error("ft: pose graph, line " + std::to_string(line_) + ": " + what);
  }
  std::int64_t id(std::istream& words) const {
    std::string word;
    words >> word;
    std::int64_t value = -1;
    char const* const end = word.data() + word.size();
    auto const result = std::from_chars(word.data(), end, value);
    if (result.ec != std::errc() || result.ptr != end || value < 0) {
      refuse("the number of a pose is missing, negative or not whole");
    }
    return value;
  }
  double number(std::istream& words, char const* name) const {
    std::string word;
    if (!(words >> word)) { refuse(std::string("there is no ") + name); }
    // A sign in front is usual in files, but not for from_chars.
    if (word[0] == '+' && word[1] != '-') { word.erase(0, 1); }
    double value = 0;
    if (!parse(word, value) || !std::isfinite(value)) {
      refuse(std::string("'") + word + "' is not a finite number: " + name);
    }
    return value;
  }
  static bool parse(std::string const& word, double& value) {
#if defined(__cpp_lib_to_chars)
    char const* const end = word.data() + word.size();
    auto const result = std::from_chars(word.data(), end, value);
    return result.ec == std::errc() && result.ptr == end;
#else
    std::istringstream text(word);
    text.imbue(std::locale::classic());
    return static_cast<bool>(text >> value) && text.eof();
#endif
  }
  rigid<double> motion(std::istream& words) const {
    rigid<double> T;
    T.t.x = number(words, "x");
    T.t.y = number(words, "y");
    T.t.z = number(words, "z");
    double q[4];
    for (double& v : q) { v = number(words, "part of the quaternion"); }
    double const norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(std::abs(norm - 1) < 0.01)) {
      refuse("the quaternion has the length " + number_text(norm) + ", not 1");
    }
    double const x = q[0] / norm;
    double const y = q[1] / norm;
    double const z = q[2] / norm;
    double const w = q[3] / norm;
    T.R = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z),
            1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x),
            1 - 2 * (x * x + y * y)}};
    return T;
  }
  void end_of_line(std::istream& words) const {
    std::string rest;
    if (words >> rest) { refuse("there is '" + rest + "' after the last number"); }
  }

  void read_vertex(std::istream& words) {
    std::int64_t const own = id(words);
    if (!index_.emplace(own, static_cast<int>(graph_.ids.size())).second) {
      refuse("pose " + std::to_string(own) + " is there twice");
    }
    graph_.ids.push_back(own);
    graph_.T_world_pose.push_back(motion(words));
    end_of_line(words);
  }
  void read_edge(std::istream& words) {
    std::int64_t const from = id(words);
    std::int64_t const to = id(words);
    if (from == to) { refuse("an edge joins pose " + std::to_string(from) + " with itself"); }
    pose_graph_edge edge;
    edge.T_from_to = motion(words);
    for (double& v : edge.information) { v = number(words, "entry of the information matrix"); }
    if (!is_semidefinite_6(edge.information)) {
      refuse("the information matrix has a negative eigenvalue");
    }
    end_of_line(words);
    graph_.edges.push_back(edge);
    ends_.push_back({from, to, line_});
  }
  void read_fixed(std::istream& words) {
    fixed_.push_back({id(words), 0, line_});
    end_of_line(words);
  }

  /// Poses may come after the edges that name them.
  void resolve() {
    auto const find = [&](std::int64_t own, int line) {
      auto const found = index_.find(own);
      line_ = line;
      if (found == index_.end()) { refuse("there is no pose " + std::to_string(own)); }
      return found->second;
    };
    for (std::size_t e = 0; e < ends_.size(); ++e) {
      graph_.edges[e].from = find(ends_[e].from, ends_[e].line);
      graph_.edges[e].to = find(ends_[e].to, ends_[e].line);
    }
    if (!fixed_.empty()) { graph_.fixed.assign(graph_.ids.size(), 0); }
    for (auto const& f : fixed_) {
      graph_.fixed[static_cast<std::size_t>(find(f.from, f.line))] = 1;
    }
  }

  pose_graph graph_;
  std::unordered_map<std::int64_t, int> index_;
  std::vector<edge_ids> ends_;
  std::vector<edge_ids> fixed_;
  int line_ = 0;
};

/// " x y z qx qy qz qw", with digits that read back as the same numbers.
inline void append_motion(std::string& line, rigid<double> const& T) {
  auto const& m = T.R.m;
  double q[4] = {m[7] - m[5], m[2] - m[6], m[3] - m[1], 1 + m[0] + m[4] + m[8]};
  if (!(q[3] > 1)) {  // more than 120 degrees: the largest of the others is larger
    int const a = m[0] >= m[4] && m[0] >= m[8] ? 0 : (m[4] >= m[8] ? 1 : 2);
    int const b = (a + 1) % 3;
    int const c = (a + 2) % 3;
    double const w = m[3 * c + b] - m[3 * b + c];
    q[a] = 1 + m[4 * a] - m[4 * b] - m[4 * c];
    q[b] = m[3 * a + b] + m[3 * b + a];
    q[c] = m[3 * a + c] + m[3 * c + a];
    q[3] = w;
  }
  double const norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  double const scale = (q[3] < 0 ? -1 : 1) / norm;
  for (double const v :
       {T.t.x, T.t.y, T.t.z, q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale}) {
    line += ' ' + number_text(v);
  }
}

}  // namespace detail

/// Reads a pose graph. Quaternions are brought to unit length. @throws error naming the line of
/// what is wrong
inline pose_graph read_g2o(std::istream& in) { return detail::g2o_reader().read(in); }
/// @throws error, also if the file cannot be opened
inline pose_graph read_g2o(std::string const& path) {
  std::ifstream in(path);
  if (!in) { throw error("ft: pose graph: cannot open '" + path + "'"); }
  try {
    return read_g2o(in);
  } catch (error const& e) { throw error(std::string(e.what()) + " ('" + path + "')"); }
}

/// Writes a pose graph, numbers with as many digits as they have. Robust kernels have no place in
/// the format. @throws bad_argument for an invalid graph; error if it cannot be written
inline void write_g2o(std::ostream& out, pose_graph const& graph) {
  check(graph);
  std::unordered_set<std::int64_t> seen;
  for (std::int64_t const own : graph.ids) {
    detail::require(own >= 0 && seen.insert(own).second,
                    "`ids` of a pose graph must be different, and not negative");
  }
  auto const id = [&](int pose) {
    auto const at = static_cast<std::size_t>(pose);
    return std::to_string(graph.ids.empty() ? pose : graph.ids[at]);
  };
  std::string line;
  for (std::size_t i = 0; i < graph.T_world_pose.size(); ++i) {
    line = "VERTEX_SE3:QUAT " + id(static_cast<int>(i));
    detail::append_motion(line, graph.T_world_pose[i]);
    out << line << '\n';
  }
  for (std::size_t i = 0; i < graph.fixed.size(); ++i) {
    if (graph.fixed[i] != 0) { out << "FIX " << id(static_cast<int>(i)) << '\n'; }
  }
  for (auto const& e : graph.edges) {
    line = "EDGE_SE3:QUAT " + id(e.from) + ' ' + id(e.to);
    detail::append_motion(line, e.T_from_to);
    for (double const v : e.information) { line += ' ' + detail::number_text(v); }
    out << line << '\n';
  }
  if (!out.flush()) { throw error("ft: pose graph: cannot be written"); }
}
inline void write_g2o(std::string const& path, pose_graph const& graph) {
  std::ofstream out(path);
  if (!out) { throw error("ft: pose graph: cannot open '" + path + "'"); }
  write_g2o(out, graph);
}

}  // namespace FT_ABI
}  // namespace ft
