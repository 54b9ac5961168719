// SPDX-License-Identifier: Apache-2.0
// Saved maps and vocabularies of which numbers were changed, with checksums that fit: refused with
// nothing changed, or harmless in the frames that follow.
#include <cstdint>
#include <cstring>
#include <sstream>
#include <string>
#include <vector>

#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/fuzz/input.hpp"
#include "tests/support/plain_vocabulary.hpp"

namespace {

constexpr int width = 160;
constexpr int height = 120;
constexpr int texels = 256;

using odometry = ft::odometry<ft::host_exec>;

ft::stereo_images frame(int i) {
  static std::vector<std::uint8_t> const wall = [] {
    std::vector<std::uint8_t> grey(texels * texels);
    std::uint32_t state = 7;
    std::vector<std::uint8_t> block(64 * 64);
    for (auto& b : block) {
      state = state * 1664525u + 1013904223u;
      b = static_cast<std::uint8_t>(state >> 24);
    }
    for (std::size_t p = 0; p < grey.size(); ++p) {
      grey[p] = block[p / texels / 5 * 64 + p % texels / 5];
    }
    return grey;
  }();
  std::uint8_t const* const from = wall.data() + 40 * texels + 20 + i;
  return {{from, width, height, texels}, {from + 6, width, height, texels}};
}

odometry make() {
  ft::odometry_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.features = 60;
  p.orb.levels = 2;
  p.map_slots = 96;
  p.local_points = 64;
  p.window_points = 64;
  p.keyframes = 3;
  p.window = {2, 1};
  p.rules.min_stereo_points = 6;
  p.rules.min_inliers = p.rules.min_motion_inliers = p.rules.min_recovered = 6;
  p.rules.min_evidence = 10;
  p.rules.keyframe_period_s = 0.05;
  return {ft::host_exec(1), ft::rectified_rig::make({100, 100, 80, 60}, 0.1), p};
}

std::string saved(odometry const& odo) {
  std::ostringstream to;
  odo.save_map(to);
  return to.str();
}

/// Values that a count, an index or a coordinate should not have.
std::uint32_t hostile(fuzz::input& in) {
  constexpr std::uint32_t known[] = {0xffffffffu, 0x80000000u, 0x7fffffffu, 0u,  1u,  2u,
                                     3u,          4u,          95u,         96u, 97u, 0x7fc00000u,
                                     0x7f800000u, 0xff800000u, 0x40000000u, 64u};
  auto const which = in.bits<std::uint8_t>();
  if (which < 160) { return known[which % 16]; }
  return which < 208 ? in.bits<std::uint32_t>() : in.bits<std::uint8_t>();
}

/// Changes words of a file, most of them in its head, in the counts or in runs.
void change(fuzz::input& in, std::string& file) {
  for (int edits = in.within(1, 6); edits > 0; --edits) {
    std::size_t const words = file.size() / 4;
    std::size_t at =
        (in.bits<std::uint16_t>() | std::size_t{in.bits<std::uint8_t>()} << 16) % words;
    std::uint32_t const value = hostile(in);
    int const run = in.flag() ? 1 : in.within(1, 200);
    for (int i = 0; i < run && at < words; ++i, ++at) {
      std::memcpy(&file[4 * at], &value, sizeof value);
    }
  }
  if (in.bits<std::uint8_t>() < 8) { file.resize(in.bits<std::uint16_t>() % (file.size() + 64)); }
}

std::uint64_t map_hash(std::string const& file) {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (std::size_t i = 0; i + 8 < file.size(); ++i) {
    hash = (hash ^ static_cast<unsigned char>(file[i])) * 0x100000001b3u;
  }
  return hash;
}

void load_map(fuzz::input& in) {
  static odometry odo = make();
  static std::string const good = [] {
    for (int i = 0; i < 8; ++i) { odo.track(frame(i), (i + 1) * 100'000'000LL); }
    return saved(odo);
  }();
  {
    std::istringstream from(good);
    odo.load_map(from);
  }
  std::string file = good;
  change(in, file);
  if (file.size() >= 8 && in.bits<std::uint8_t>() < 250) {
    std::uint64_t const hash = map_hash(file);
    std::memcpy(&file[file.size() - 8], &hash, sizeof hash);
  }
  std::istringstream from(file);
  bool const taken = fuzz::accepted<ft::error>([&] { odo.load_map(from); });
  if (!taken && in.bits<std::uint8_t>() < 32) {
    fuzz::require(saved(odo) == good, "a map that is refused changes nothing");
  }
  if (!taken) { return; }
  for (int i = 0; i < 4; ++i) { odo.track(frame(7 + i), (i + 1) * 100'000'000LL); }
  odo.download_map();
}

void check(ft::vocabulary_view const& v, fuzz::input& in) {
  for (int walk = 0; walk < 8; ++walk) {
    int node = 0;
    int depth = 0;
    for (; v.children[node].count > 0; ++depth) {
      ft::node_children const& c = v.children[node];
      fuzz::require(c.first > node && c.first + c.count <= v.nodes, "children are nodes");
      node = c.first + in.bits<std::uint8_t>() % c.count;
    }
    fuzz::require(depth <= v.header.levels, "a tree is no deeper than its levels");
    fuzz::require(node == 0 || static_cast<int>(v.word[node]) < v.words, "a leaf is a word");
  }
}

void load_vocabulary(fuzz::input& in) {
  static auto const made = ft::make_vocabulary(test::drawn_vocabulary(3, 3).arrays());
  static std::string const good = [] {
    std::ostringstream to;
    ft::save_vocabulary(to, made.view());
    return to.str();
  }();
  std::string file = good;
  change(in, file);
  for (int i = in.within(0, 3); i > 0 && file.size() > 84; --i) {  // the numbers of children
    file[44 + in.bits<std::uint8_t>() % 40] = static_cast<char>(in.within(0, 4));
  }
  auto const nodes = static_cast<std::size_t>(made->nodes);
  if (file.size() == good.size()) {
    ft::detail::checksum sum;
    std::size_t at = 0;
    for (std::size_t const bytes :
         {std::size_t{44}, nodes, 4 * nodes, 4 * nodes, 8 * nodes, 32 * nodes}) {
      sum.add(file.data() + at, bytes);
      at += bytes;
    }
    std::uint64_t const value = sum.value();
    std::memcpy(&file[at], &value, sizeof value);
  }
  std::istringstream from(file);
  fuzz::accepted<ft::error>([&] { check(ft::load_vocabulary(from).view(), in); });
}

void read_text(fuzz::input& in) {
  std::string text = "2 2 0 0\n";
  if (in.bits<std::uint8_t>() < 40) { text.clear(); }
  for (int lines = in.within(0, 5); lines > 0; --lines) {
    text += std::to_string(in.within(-1, 5)) + (in.flag() ? " 1" : " 0");
    for (int byte = in.bits<std::uint8_t>() < 8 ? 31 : 32; byte > 0; --byte) {
      text += " " + std::to_string(in.within(0, 255));
    }
    text += " " + std::to_string(in.number(0, 1)) + "\n";
  }
  text.append(reinterpret_cast<char const*>(in.data()), in.left() / 2);
  std::istringstream from(text);
  fuzz::accepted<ft::error>([&] { check(ft::read_vocabulary_text(from).view(), in); });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(std::uint8_t const* data, std::size_t size) {
  fuzz::input in(data, size);
  auto const kind = in.bits<std::uint8_t>();
  switch (kind % 4) {
    case 0:
      read_text(in);
      break;
    case 1:
      load_vocabulary(in);
      break;
    default:
      load_map(in);
  }
  return 0;
}
