// SPDX-License-Identifier: Apache-2.0
/// @file Pose graphs in g2o's text format: lines VERTEX_SE3:QUAT id x y z qx qy qz qw;
/// EDGE_SE3:QUAT id id, the same seven numbers and the upper triangle of the information matrix by
/// rows, translation first; FIX id.
///
/// Similarities are VERTEX_SIM3:EXPMAP id and seven numbers, then four numbers of a camera or none;
/// EDGE_SIM3:EXPMAP id id, seven numbers and the upper triangle of the information matrix by rows.
/// The seven are the logarithm of the pose or the measurement: rotation vector, translation part of
/// the tangent vector, natural logarithm of the scale (exp_sim3 in math/sim3.hpp). g2o keeps the
/// inverses, T_pose_world and T_to_from, and writes the logarithms of their inverses: these are
/// T_world_pose and T_from_to. Its error is the logarithm of the motion that is left, the rotation
/// first. For small errors that is ft's with the vector part of the quaternion doubled, so the
/// rotation's entries of the information matrix are 1/4 of ft's, and 1/2 beside other unknowns.
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
#include "ft/math/sim3.hpp"
#include "ft/types/errors.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// What lines begin with.
template <typename Motion>
struct g2o_tags {
  static constexpr char const* vertex = "VERTEX_SE3:QUAT";
  static constexpr char const* edge = "EDGE_SE3:QUAT";
};
template <>
struct g2o_tags<similarity<double>> {
  static constexpr char const* vertex = "VERTEX_SIM3:EXPMAP";
  static constexpr char const* edge = "EDGE_SIM3:EXPMAP";
};

/// Calls use(place in ft's information matrix, factor from the file's entry) for each entry of the
/// upper triangle of a file's. Factors are powers of 2.
template <typename Motion, typename Use>
void for_each_information(Use const& use) {
  constexpr int n = freedom_of<Motion>;
  for (int i = 0; i < n; ++i) {
    for (int j = i; j < n; ++j) {
      // Of similarities files have the rotation before the translation.
      auto const own = [](int k) { return n == 6 || k == 6 ? k : (k + 3) % 6; };
      auto const doubled = [](int k) { return n == 7 && k < 3 ? 2.0 : 1.0; };
      int const low = own(i) < own(j) ? own(i) : own(j);
      int const high = own(i) + own(j) - low;
      use(low * (2 * n - 1 - low) / 2 + high, doubled(i) * doubled(j));
    }
  }
}

/// Reads lines of g2o's format.
template <typename Motion>
class g2o_reader {
public:
  motion_graph<Motion> read(std::istream& in) {
    std::string text;
    while (std::getline(in, text)) {
      ++line_;
      std::istringstream words(text);
      words.imbue(std::locale::classic());
      std::string tag;
      if (!(words >> tag) || tag[0] == '#') { continue; }
      if (tag == tags::vertex) {
        read_vertex(words);
      } else if (tag == tags::edge) {
        read_edge(words);
      } else if (tag == "FIX") {
        read_fixed(words);
      } else {
        refuse("there is '" + tag + "', which is not " + tags::vertex + ", " + tags::edge +
               " or FIX");
      }
    }
    if (in.bad()) { throw error("ft: pose graph: cannot be read"); }
    resolve();
    return std::move(graph_);
  }

private:
  using tags = g2o_tags<Motion>;
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
  void read_motion(std::istream& words, rigid<double>& T) const {
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
  }
  void read_motion(std::istream& words, similarity<double>& T) const {
    strict_double d[7];
    for (int k = 0; k < 7; ++k) {
      d[k] = number(words, k < 3   ? "part of the rotation vector"
                           : k < 6 ? "part of the translation"
                                   : "logarithm of the scale");
    }
    double const angle = norm(strict_vec3d{d[0], d[1], d[2]}).value;
    if (!(angle < 6.3)) {
      refuse("the rotation vector has the length " + number_text(angle) + ", more than a turn");
    }
    if (!(std::abs(d[6].value) < 115)) {
      refuse("the logarithm of the scale is " + number_text(d[6].value) + ", not in (-115, 115)");
    }
    T = exp_sim3(d).template cast<double>();
    if (!std::isfinite(T.t.x + T.t.y + T.t.z)) { refuse("the translation is too large"); }
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
    graph_.T_world_pose.emplace_back();
    read_motion(words, graph_.T_world_pose.back());
    if (freedom_of<Motion> == 7 && !(words >> std::ws).eof()) {
      for (int k = 0; k < 4; ++k) { number(words, "number of the camera"); }
    }
    end_of_line(words);
  }
  void read_edge(std::istream& words) {
    std::int64_t const from = id(words);
    std::int64_t const to = id(words);
    if (from == to) { refuse("an edge joins pose " + std::to_string(from) + " with itself"); }
    motion_edge<Motion> edge;
    read_motion(words, edge.T_from_to);
    for_each_information<Motion>([&](int at, double factor) {
      edge.information[at] = factor * number(words, "entry of the information matrix");
    });
    for (double const v : edge.information) {
      if (!std::isfinite(v)) { refuse("an entry of the information matrix is too large"); }
    }
    if (!is_semidefinite<freedom_of<Motion>>(edge.information)) {
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

  motion_graph<Motion> graph_;
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

inline void append_motion(std::string& line, similarity<double> const& T) {
  strict_double d[7];
  log_sim3(T.cast<strict_double>(), d);
  for (auto const& v : d) { line += ' ' + number_text(v.value); }
}

template <typename Motion>
motion_graph<Motion> read_g2o_file(std::string const& path) {
  std::ifstream in(path);
  if (!in) { throw error("ft: pose graph: cannot open '" + path + "'"); }
  try {
    return g2o_reader<Motion>().read(in);
  } catch (error const& e) { throw error(std::string(e.what()) + " ('" + path + "')"); }
}

}  // namespace detail

/// Reads a pose graph. Quaternions are brought to unit length. @throws error naming the line of
/// what is wrong
inline pose_graph read_g2o(std::istream& in) {
  return detail::g2o_reader<rigid<double>>().read(in);
}
/// @throws error, also if the file cannot be opened
inline pose_graph read_g2o(std::string const& path) {
  return detail::read_g2o_file<rigid<double>>(path);
}

/// The same of poses with scales. The numbers of cameras are not kept.
inline similarity_graph read_g2o_similarities(std::istream& in) {
  return detail::g2o_reader<similarity<double>>().read(in);
}
inline similarity_graph read_g2o_similarities(std::string const& path) {
  return detail::read_g2o_file<similarity<double>>(path);
}

/// Writes a graph of poses, numbers with as many digits as they have; for similarities the camera
/// that g2o has by default, 1 1 0 0. Robust kernels have no place in the format. @throws
/// bad_argument for an invalid graph; error if it cannot be written
template <typename Motion>
void write_g2o(std::ostream& out, motion_graph<Motion> const& graph) {
  using tags = detail::g2o_tags<Motion>;
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
    line = tags::vertex + (' ' + id(static_cast<int>(i)));
    detail::append_motion(line, graph.T_world_pose[i]);
    if (detail::freedom_of<Motion> == 7) { line += " 1 1 0 0"; }
    out << line << '\n';
  }
  for (std::size_t i = 0; i < graph.fixed.size(); ++i) {
    if (graph.fixed[i] != 0) { out << "FIX " << id(static_cast<int>(i)) << '\n'; }
  }
  for (auto const& e : graph.edges) {
    line = tags::edge + (' ' + id(e.from)) + ' ' + id(e.to);
    detail::append_motion(line, e.T_from_to);
    detail::for_each_information<Motion>([&](int at, double factor) {
      line += ' ' + detail::number_text(e.information[at] / factor);
    });
    out << line << '\n';
  }
  if (!out.flush()) { throw error("ft: pose graph: cannot be written"); }
}
template <typename Motion>
void write_g2o(std::string const& path, motion_graph<Motion> const& graph) {
  std::ofstream out(path);
  if (!out) { throw error("ft: pose graph: cannot open '" + path + "'"); }
  write_g2o(out, graph);
}

}  // namespace FT_ABI
}  // namespace ft
