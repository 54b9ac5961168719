// SPDX-License-Identifier: Apache-2.0
/// @file Compares vocabularies, and bags of words made with them, with golden_words: the folders
/// vocabularies, transform and scoring.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/kernels/words/transform.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"
#include "tests/support/plain_vocabulary.hpp"

namespace test {

/// Rows of 32 bytes.
inline std::vector<ft::descriptor> descriptors_of(npy<std::uint8_t> const& bytes) {
  std::vector<ft::descriptor> rows(static_cast<std::size_t>(bytes.rows()));
  static_assert(sizeof(ft::descriptor) == 32, "a row");
  if (!rows.empty()) {
    std::memcpy(static_cast<void*>(rows.data()), bytes.data.data(), bytes.data.size());
  }
  return rows;
}

/// A vocabulary of golden_words by name, as recorded arrays or from its rule.
inline plain_vocabulary golden_vocabulary(std::string const& folder, std::string const& name) {
  if (name == "synth" || name == "synth_k10_L6") { return drawn_vocabulary(10, 6); }
  std::string const at = folder + "/vocabularies/" + name + "/";
  auto const header = read_npy<std::int32_t>(at + "k_L_scoring_weighting.npy");
  plain_vocabulary v;
  v.header = {header(0), header(1), static_cast<ft::word_scoring>(header(2)),
              static_cast<ft::word_weighting>(header(3))};
  v.parent = read_npy<std::int32_t>(at + "parent.npy").data;
  v.word = read_npy<std::int32_t>(at + "word.npy").data;
  v.weight = read_npy<double>(at + "weight.npy").data;
  v.orb = descriptors_of(read_npy<std::uint8_t>(at + "desc.npy"));
  return v;
}

/// What a stage wrote about one frame, in host memory.
struct frame_words {
  std::vector<std::uint32_t> word, node, bag_word, group_node;
  std::vector<double> weight, bag_value;
  std::vector<int> group_start, group_keypoint;
};

/// Transforms one frame's descriptors.
template <typename Exec>
frame_words words_of(Exec const& exec, ft::vocabulary_view const& vocabulary,
                     std::vector<ft::descriptor> const& descriptors, int levels_up) {
  int const n = static_cast<int>(descriptors.size());
  ft::soa<Exec::space, ft::field::orb> in(std::max(n, 1));
  ft::copy(exec, ft::array_of<ft::field::orb>(in.view()), descriptors.data(), descriptors.size());
  ft::copy(exec, in->count, &n, 1);
  exec.wait();
  ft::owner<ft::frame_words_view, Exec::space> const out(
      [&](ft::carver& c, ft::frame_words_view& v) { carve(c, v, 1, in.capacity()); });
  ft::owner<ft::transform_workspace, Exec::space> const work(
      [&](ft::carver& c, ft::transform_workspace& w) { carve(c, w, 1, in.capacity()); });
  ft::transform_to_words(exec, vocabulary, in.view(), {levels_up}, out.view(), work.view());
  auto const count = [&](int const* of) {
    return static_cast<std::size_t>(from_exec(exec, of, 1)[0]);
  };
  auto const words = count(out->bag.count);
  auto const groups = count(out->groups.count);
  auto const size = descriptors.size();
  frame_words got;
  got.word = from_exec(exec, out->features.word, size);
  got.node = from_exec(exec, out->features.node, size);
  got.weight = from_exec(exec, out->features.weight, size);
  got.bag_word = from_exec(exec, out->bag.word, words);
  got.bag_value = from_exec(exec, out->bag.value, words);
  got.group_node = from_exec(exec, out->groups.node, groups);
  got.group_start = from_exec(exec, out->groups.start, groups + 1);
  got.group_keypoint =
      from_exec(exec, out->groups.keypoint, static_cast<std::size_t>(got.group_start.back()));
  return got;
}

/// Vocabularies, transform and scoring of golden_words on one executor.
template <typename Exec>
class golden_transform {
public:
  golden_transform(Exec const& exec, std::string folder)
      : exec_(exec), folder_(std::move(folder)) {}

  void run(conformance_table& table) {
    compare_texts(table["vocabulary_text"]);
    for (auto const& entry : std::filesystem::directory_iterator(folder_ + "/transform")) {
      compare_case(table, entry.path().string(), entry.path().filename().string());
    }
    compare_bags(table["transform_bag"]);
  }

private:
  using owner = ft::vocabulary<Exec::space>;

  /// The bytes that a command prints. @throws std::runtime_error if it fails
  static std::string printed(std::string const& command) {
    std::FILE* const pipe = ::popen(command.c_str(), "r");
    if (pipe == nullptr) { throw std::runtime_error("cannot run: " + command); }
    std::string bytes;
    char block[4096];
    for (std::size_t n = 0; (n = std::fread(block, 1, sizeof block, pipe)) > 0;) {
      bytes.append(block, n);
    }
    if (::pclose(pipe) != 0) { throw std::runtime_error("failed: " + command); }
    return bytes;
  }

  void compare_texts(stage_result& r) const {
    std::string const at = folder_ + "/vocabularies/";
    std::ifstream file(at + "kimera.txt");
    compare_vocabularies(r, ft::read_vocabulary_text(file).view(), "kimera");
    std::istringstream text(printed("gzip -dc '" + at + "slambook.txt.gz'"));
    compare_vocabularies(r, ft::read_vocabulary_text(text).view(), "slambook");
  }
  void compare_vocabularies(stage_result& r, ft::vocabulary_view const& got,
                            std::string const& name) const {
    auto const plain = golden_vocabulary(folder_, name);
    auto const& h = got.header;
    r.add(h.branching == plain.header.branching && h.levels == plain.header.levels &&
          h.scoring == plain.header.scoring && h.weighting == plain.header.weighting);
    r.add(got.nodes == plain.nodes());
    std::vector<std::uint32_t> parent(plain.parent.size(), ft::no_word);
    for (int i = 0; i < got.nodes; ++i) {
      for (int c = 0; c < got.children[i].count; ++c) {
        parent.at(got.node[got.children[i].first + c]) = got.node[i];
      }
    }
    for (int i = 0; i < got.nodes && got.nodes == plain.nodes(); ++i) {
      auto const id = got.node[i];
      r.add(parent[id] == static_cast<std::uint32_t>(plain.parent[id]) &&
            got.word[i] == static_cast<std::uint32_t>(plain.word[id]) &&
            same_bits(got.weight[i], plain.weight[id]) &&
            (id == 0 || ft::hamming(got.orb[i], plain.orb[id]) == 0));
    }
  }
  static bool same_bits(double a, double b) { return std::memcmp(&a, &b, sizeof a) == 0; }

  owner const& vocabulary_of(std::string const& name) {
    auto& made = vocabularies_[name];
    if (!made) {
      auto const host = ft::make_vocabulary(golden_vocabulary(folder_, name).arrays());
      made = std::make_unique<owner>(ft::upload(exec_, host.view()));
    }
    return *made;
  }
  std::vector<ft::descriptor> descriptors(std::string const& frame) const {
    return descriptors_of(read_npy<std::uint8_t>(folder_ + "/frames/" + frame + "/desc.npy"));
  }

  template <typename T, typename U>
  static void compare_list(stage_result& r, std::vector<T> const& got, std::vector<U> const& want) {
    r.add(got.size() == want.size());
    for (std::size_t i = 0; i < std::min(got.size(), want.size()); ++i) {
      if constexpr (std::is_same<T, double>::value) {
        r.add(same_bits(got[i], want[i]), std::abs(got[i] - want[i]));
      } else {
        r.add(static_cast<std::uint32_t>(got[i]) == static_cast<std::uint32_t>(want[i]));
      }
    }
  }

  /// @param name FRAME_VOCABULARY_upU
  void compare_case(conformance_table& table, std::string const& at, std::string const& name) {
    auto const up = name.rfind("_up");
    auto const before = name.rfind('_', up - 1);
    auto const got = words_of(exec_, vocabulary_of(name.substr(before + 1, up - before - 1)).view(),
                              descriptors(name.substr(0, before)), std::stoi(name.substr(up + 3)));
    auto& features = table["transform_features"];
    compare_list(features, got.word, read_npy<std::uint32_t>(at + "/word.npy").data);
    compare_list(features, got.weight, read_npy<double>(at + "/weight.npy").data);
    auto const node = read_npy<std::uint32_t>(at + "/node.npy").data;
    features.add(node.size() == got.node.size());
    for (std::size_t i = 0; i < std::min(node.size(), got.node.size()); ++i) {
      if (node[i] != 0xffffffffu) { features.add(got.node[i] == node[i]); }
    }
    auto& bag = table["transform_bag"];
    compare_list(bag, got.bag_word, read_npy<std::uint32_t>(at + "/bow_word.npy").data);
    compare_list(bag, got.bag_value, read_npy<double>(at + "/bow_value.npy").data);
    if (!exists(at + "/fv_node.npy")) { return; }
    auto& groups = table["transform_groups"];
    compare_list(groups, got.group_node, read_npy<std::uint32_t>(at + "/fv_node.npy").data);
    compare_list(groups, got.group_start, read_npy<std::int32_t>(at + "/fv_start.npy").data);
    compare_list(groups, got.group_keypoint, read_npy<std::uint32_t>(at + "/fv_index.npy").data);
  }

  /// Vocabulary kimera with every scoring and weighting that bags were recorded of.
  void compare_bags(stage_result& r) const {
    auto plain = golden_vocabulary(folder_, "kimera");
    for (int scoring = 0; scoring < 6; ++scoring) {
      for (int weighting = 0; weighting < 4; ++weighting) {
        plain.header.scoring = static_cast<ft::word_scoring>(scoring);
        plain.header.weighting = static_cast<ft::word_weighting>(weighting);
        auto const made = ft::upload(exec_, ft::make_vocabulary(plain.arrays()).view());
        for (std::string const frame : {"0", "1"}) {
          std::string const at = folder_ + "/scoring/s" + std::to_string(scoring) + "_w" +
                                 std::to_string(weighting) + "_" + frame + "_bow_";
          if (!exists(at + "word.npy")) { continue; }
          auto const got = words_of(exec_, made.view(), descriptors("euroc_mono_" + frame), 4);
          compare_list(r, got.bag_word, read_npy<std::uint32_t>(at + "word.npy").data);
          compare_list(r, got.bag_value, read_npy<double>(at + "value.npy").data);
        }
      }
    }
  }

  Exec exec_;
  std::string folder_;
  std::map<std::string, std::unique_ptr<owner>> vocabularies_;
};

}  // namespace test
