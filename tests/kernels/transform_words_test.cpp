// SPDX-License-Identifier: Apache-2.0
// From descriptors to bags of words and groups: against a plain reading of the rule on vocabularies
// of all shapes, scorings and weightings; frames of all sizes, batches, bad input.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/words/transform.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"

namespace transform_words_test {

using ft::word_scoring;
using ft::word_weighting;
using test::at;
using test::generator;
using test::plain_vocabulary;

using frame = std::vector<ft::descriptor>;

/// Words, bag and groups of a frame.
struct answer {
  std::vector<std::uint32_t> word, node, bag_word, group_node;
  std::vector<double> weight, bag_value;
  std::vector<std::vector<int>> group;
};

/// The rule, read plainly.
class oracle {
public:
  explicit oracle(plain_vocabulary const& v) : v_(v), children_(v.parent.size()) {
    for (int i = 1; i < v.nodes(); ++i) { children_[at(v.parent[at(i)])].push_back(i); }
  }

  answer transform(frame const& descriptors, int levels_up) const {
    answer a;
    std::map<std::uint32_t, double> bag;
    std::map<std::uint32_t, std::vector<int>> groups;
    auto const weighting = v_.header.weighting;
    bool const adds = weighting == word_weighting::tf_idf || weighting == word_weighting::tf;
    for (std::size_t f = 0; f < descriptors.size(); ++f) {
      int group = 0;
      int const node = word_of(descriptors[f], levels_up, group);
      double const weight = node == 0 ? 0.0 : v_.weight[at(node)];
      a.word.push_back(static_cast<std::uint32_t>(v_.word[at(node)]));
      a.node.push_back(static_cast<std::uint32_t>(group));
      a.weight.push_back(weight);
      if (!(weight > 0)) { continue; }
      groups[a.node.back()].push_back(static_cast<int>(f));
      auto const place = bag.emplace(a.word.back(), weight);
      if (!place.second && adds) { place.first->second += weight; }
    }
    double const by = norm(bag, adds);
    for (auto const& [word, value] : bag) {
      a.bag_word.push_back(word);
      a.bag_value.push_back(by > 0 ? value / by : value);
    }
    for (auto const& [node, features] : groups) {
      a.group_node.push_back(node);
      a.group.push_back(features);
    }
    return a;
  }

private:
  int word_of(ft::descriptor const& d, int levels_up, int& group) const {
    int node = 0;
    for (int depth = 1; !children_[at(node)].empty(); ++depth) {
      int best = 257;
      int next = 0;
      for (int const c : children_[at(node)]) {
        int distance = 0;
        for (int w = 0; w < 8; ++w) {
          distance += __builtin_popcount(d.words[w] ^ v_.orb[at(c)].words[w]);
        }
        if (distance < best) {
          best = distance;
          next = c;
        }
      }
      node = next;
      if (depth <= v_.header.levels - levels_up) { group = node; }
    }
    return node;
  }
  double norm(std::map<std::uint32_t, double> const& bag, bool adds) const {
    if (v_.header.scoring == word_scoring::dot_product) {
      return adds ? static_cast<double>(bag.size()) : 0.0;
    }
    double sum = 0;
    for (auto const& entry : bag) {
      double const value = entry.second;
      double volatile const square = value * value;  // rounded on its own
      sum += v_.header.scoring == word_scoring::l2 ? square : std::abs(value);
    }
    return v_.header.scoring == word_scoring::l2 ? std::sqrt(sum) : sum;
  }

  plain_vocabulary const& v_;
  std::vector<std::vector<int>> children_;
};

/// Runs the stage on a batch of frames, in memory that has garbage in it.
template <typename Exec>
std::vector<answer> run(Exec const& exec, ft::vocabulary_view const& vocabulary,
                        std::vector<frame> const& frames, int levels_up, int capacity) {
  int const batch = static_cast<int>(frames.size());
  ft::keypoints<Exec::space> in(capacity, batch);
  std::vector<ft::descriptor> rows(at(capacity) * at(batch));
  std::vector<int> counts;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    std::copy(frames[f].begin(), frames[f].end(), rows.begin() + static_cast<long>(f) * capacity);
    counts.push_back(static_cast<int>(frames[f].size()));
  }
  ft::copy(exec, ft::array_of<ft::field::orb>(in.view()), rows.data(), rows.size());
  ft::copy(exec, in->count, counts.data(), counts.size());
  exec.wait();
  ft::owner<ft::frame_words_view, Exec::space> const out(
      [&](ft::carver& c, ft::frame_words_view& v) { carve(c, v, batch, capacity); });
  ft::owner<ft::transform_workspace, Exec::space> const work(
      [&](ft::carver& c, ft::transform_workspace& w) { carve(c, w, batch, capacity); });
  ft::transform_to_words(exec, vocabulary, in.view(), {levels_up}, out.view(), work.view());
  std::vector<answer> answers;
  for (int f = 0; f < batch; ++f) {
    auto const first = out->features.at(f);
    auto const size = frames[at(f)].size();
    auto const words = at(test::from_exec(exec, out->bag.count + f, 1)[0]);
    auto const groups = at(test::from_exec(exec, out->groups.count + f, 1)[0]);
    answer a;
    a.word = test::from_exec(exec, out->features.word + first, size);
    a.node = test::from_exec(exec, out->features.node + first, size);
    a.weight = test::from_exec(exec, out->features.weight + first, size);
    a.bag_word = test::from_exec(exec, out->bag.word + first, words);
    a.bag_value = test::from_exec(exec, out->bag.value + first, words);
    a.group_node = test::from_exec(exec, out->groups.node + first, groups);
    auto const start =
        test::from_exec(exec, out->groups.start + out->groups.start_at(f), groups + 1);
    auto const members = test::from_exec(exec, out->groups.keypoint + first, at(start.back()));
    EXPECT_EQ(start[0], 0);
    for (std::size_t g = 0; g < groups; ++g) {
      a.group.emplace_back(members.begin() + start[g], members.begin() + start[g + 1]);
    }
    answers.push_back(a);
  }
  return answers;
}

bool same_bits(std::vector<double> const& a, std::vector<double> const& b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(double)) == 0);
}

void expect_same(answer const& got, answer const& want) {
  EXPECT_EQ(got.word, want.word);
  EXPECT_EQ(got.node, want.node);
  EXPECT_TRUE(same_bits(got.weight, want.weight));
  EXPECT_EQ(got.bag_word, want.bag_word);
  EXPECT_TRUE(same_bits(got.bag_value, want.bag_value));
  EXPECT_EQ(got.group_node, want.group_node);
  EXPECT_EQ(got.group, want.group);
}

/// Descriptors near those of nodes, several the same, some far from all.
frame random_frame(generator& random, plain_vocabulary const& v, int count) {
  frame descriptors;
  for (int i = 0; i < count; ++i) {
    if (i > 0 && random.chance(20)) {
      descriptors.push_back(descriptors[at(random.below(i))]);
    } else if (random.chance(10)) {
      descriptors.push_back(random.descriptor());
    } else {
      descriptors.push_back(random.flipped(v.orb[at(random.below(v.nodes()))], random.below(60)));
    }
  }
  return descriptors;
}

/// The stage against the oracle.
template <typename Exec>
void compare(Exec const& exec, plain_vocabulary const& v, std::vector<frame> const& frames,
             int levels_up, int capacity) {
  auto const made = ft::upload(exec, ft::make_vocabulary(v.arrays()).view());
  auto const got = run(exec, made.view(), frames, levels_up, capacity);
  oracle const rule(v);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    SCOPED_TRACE("frame " + std::to_string(f));
    expect_same(got[f], rule.transform(frames[f], levels_up));
  }
}

template <typename Backend>
class TransformWords : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(TransformWords, test::backends);

TYPED_TEST(TransformWords, IsTheRuleReadPlainly) {
  TypeParam backend;
  generator random(1);
  for (int round = 0; round < test::effort(60); ++round) {
    SCOPED_TRACE(round);
    int const levels = random.from_to(1, 6);
    auto v = test::random_vocabulary(random, random.from_to(1, levels > 3 ? 4 : 20), levels,
                                     random.below(60));
    if (random.chance(50)) { v = test::with_shuffled_ids(v, static_cast<unsigned>(round)); }
    v.header.scoring = static_cast<word_scoring>(round % 6);
    v.header.weighting = static_cast<word_weighting>(round / 6 % 4);
    int const capacity = random.from_to(1, 200);
    std::vector<frame> frames;
    for (int f = random.from_to(1, 3); f > 0; --f) {
      frames.push_back(random_frame(random, v, random.from_to(0, capacity)));
    }
    compare(backend.exec, v, frames, random.below(7), capacity);
  }
}

TYPED_TEST(TransformWords, TakesTheFirstOfEqualChildren) {
  TypeParam backend;
  generator random(2);
  plain_vocabulary v;
  v.header = {20, 1};
  auto const d = random.descriptor();
  for (int i = 0; i < 20; ++i) {
    int const node = v.add(0, i < 3 ? random.descriptor() : d);
    v.word[at(node)] = 19 - i;
    v.weight[at(node)] = 1;
  }
  auto const made = ft::upload(backend.exec, ft::make_vocabulary(v.arrays()).view());
  auto const got = run(backend.exec, made.view(), {{d}}, 0, 1)[0];
  EXPECT_EQ(got.word, std::vector<std::uint32_t>{16}) << "node 4";
  EXPECT_EQ(got.node, std::vector<std::uint32_t>{4});
}

TYPED_TEST(TransformWords, GroupsByTheNodePassedOrTheWordAboveIt) {
  TypeParam backend;
  generator random(3);
  // A chain of three levels, and a leaf below the root.
  plain_vocabulary v;
  v.header = {2, 3};
  auto const d = random.descriptor();
  auto const other = random.descriptor();
  int const deep = v.add(v.add(v.add(0, d), d), d);
  int const shallow = v.add(0, other);
  v.word[at(deep)] = 1;
  v.word[at(shallow)] = 0;
  v.weight[at(deep)] = v.weight[at(shallow)] = 2;
  auto const made = ft::upload(backend.exec, ft::make_vocabulary(v.arrays()).view());
  std::vector<std::vector<std::uint32_t>> const nodes{{3, 4}, {2, 4}, {1, 4}, {0, 0}, {0, 0}};
  for (int up = 0; up < 5; ++up) {
    auto const got = run(backend.exec, made.view(), {{d, other}}, up, 2)[0];
    EXPECT_EQ(got.node, nodes[at(up)]) << up;
    EXPECT_EQ(got.group.size(), up < 3 ? 2u : 1u);
  }
}

TYPED_TEST(TransformWords, StopsWordsWithoutAPositiveWeight) {
  TypeParam backend;
  generator random(4);
  plain_vocabulary v;
  v.header = {3, 1};
  for (double const weight : {0.0, -1.0, 0.5}) {
    int const node = v.add(0, random.descriptor());
    v.word[at(node)] = node - 1;
    v.weight[at(node)] = weight;
  }
  auto const made = ft::upload(backend.exec, ft::make_vocabulary(v.arrays()).view());
  auto const got = run(backend.exec, made.view(), {{v.orb[1], v.orb[2], v.orb[3], v.orb[1]}}, 4, 4);
  EXPECT_EQ(got[0].word, (std::vector<std::uint32_t>{0, 1, 2, 0})) << "they have words";
  EXPECT_EQ(got[0].bag_word, std::vector<std::uint32_t>{2});
  EXPECT_EQ(got[0].bag_value, std::vector<double>{1.0});
  EXPECT_EQ(got[0].group, std::vector<std::vector<int>>{{2}});
  auto const none = run(backend.exec, made.view(), {{v.orb[1], v.orb[2]}}, 4, 4)[0];
  EXPECT_TRUE(none.bag_word.empty() && none.group_node.empty()) << "all are stopped";
}

TYPED_TEST(TransformWords, AddsEqualDescriptorsOneByOne) {
  TypeParam backend;
  generator random(5);
  plain_vocabulary v;
  v.header = {1, 1, word_scoring::dot_product, word_weighting::tf};
  v.add(0, random.descriptor());
  v.word[1] = 0;
  v.weight[1] = 0.1;
  int const count = 3000;
  double sum = 0;
  for (int i = 0; i < count; ++i) { sum += 0.1; }
  ASSERT_NE(sum, 0.1 * count) << "the order of rounding matters";
  auto const made = ft::upload(backend.exec, ft::make_vocabulary(v.arrays()).view());
  frame const descriptors(at(count), random.descriptor());
  auto const got = run(backend.exec, made.view(), {descriptors}, 0, count)[0];
  EXPECT_TRUE(same_bits(got.bag_value, {sum}));
  EXPECT_EQ(got.group[0].size(), at(count));
}

TYPED_TEST(TransformWords, HasNoLimitOfFeatures) {
  TypeParam backend;
  generator random(6);
  auto v = test::random_vocabulary(random, 6, 4, 10);
  v.header.weighting = word_weighting::tf;
  // Of one frame the keys fit into the shared memory of an H200, of many they do not.
  compare(backend.exec, v, {random_frame(random, v, 9001)}, 2, 9001);
  std::vector<frame> many(70);
  many[0] = random_frame(random, v, 8000);
  many[69] = random_frame(random, v, 7999);
  many[3] = random_frame(random, v, 100);
  compare(backend.exec, v, many, 2, 8000);
  // Nor of what fits into a device's shared memory at all.
  compare(backend.exec, v, {random_frame(random, v, 40000)}, 2, 40000);
}

TYPED_TEST(TransformWords, EmptyVocabulariesAndFramesGiveEmptyLists) {
  TypeParam backend;
  generator random(7);
  plain_vocabulary root;
  root.weight[0] = 3;
  compare(backend.exec, root, {{random.descriptor(), random.descriptor()}, {}}, 4, 5);
  auto const nothing = run(backend.exec, ft::vocabulary_view{}, {{random.descriptor()}}, 4, 5)[0];
  EXPECT_EQ(nothing.word, std::vector<std::uint32_t>{ft::no_word});
  EXPECT_EQ(nothing.node, std::vector<std::uint32_t>{0});
  EXPECT_TRUE(same_bits(nothing.weight, {0.0}));
  EXPECT_TRUE(nothing.bag_word.empty() && nothing.group_node.empty());
  auto const v = test::random_vocabulary(random, 4, 2, 0);
  compare(backend.exec, v, {{}, {}, {v.orb[1]}}, 1, 1);
}

TYPED_TEST(TransformWords, CountsOutOfRangeAreTheNearestInRange) {
  TypeParam backend;
  auto const& exec = backend.exec;
  generator random(8);
  auto const v = test::random_vocabulary(random, 4, 3, 0);
  auto const made = ft::upload(exec, ft::make_vocabulary(v.arrays()).view());
  auto const rows = random_frame(random, v, 8);
  auto const orb = test::to_exec(exec, rows);
  auto const count = test::to_exec(exec, std::vector<int>{-5, 1 << 30});
  ft::descriptors_view in;
  static_cast<ft::column<ft::field::orb>&>(in).data = orb.data();
  in.capacity = 4;
  in.batch = 2;
  in.count = count.data();
  ft::owner<ft::frame_words_view, TypeParam::exec_type::space> const out(
      [](ft::carver& c, ft::frame_words_view& o) { carve(c, o, 2, 7); });
  ft::owner<ft::transform_workspace, TypeParam::exec_type::space> const work(
      [](ft::carver& c, ft::transform_workspace& w) { carve(c, w, 2, 9); });
  ft::transform_to_words(exec, made.view(), in, {}, out.view(), work.view());
  EXPECT_EQ(test::from_exec(exec, out->bag.count, 1)[0], 0);
  auto const want = oracle(v).transform({rows.begin() + 4, rows.end()}, 4);
  auto const words = at(test::from_exec(exec, out->bag.count, 2)[1]);
  EXPECT_EQ(test::from_exec(exec, out->bag.word + out->bag.at(1), words), want.bag_word);
  EXPECT_EQ(test::from_exec(exec, out->features.word + out->features.at(1), 4), want.word)
      << "lists may have more room than the descriptors";
}

TYPED_TEST(TransformWords, RefusesShapesThatDoNotFit) {
  TypeParam backend;
  auto const& exec = backend.exec;
  auto const made = ft::upload(exec, ft::make_vocabulary(plain_vocabulary{}.arrays()).view());
  ft::keypoints<TypeParam::exec_type::space> const in(5, 2);
  using out_type = ft::owner<ft::frame_words_view, TypeParam::exec_type::space>;
  using work_type = ft::owner<ft::transform_workspace, TypeParam::exec_type::space>;
  auto const refuses = [&](int frames, int capacity, int work_capacity, int up) {
    out_type const out(
        [&](ft::carver& c, ft::frame_words_view& v) { carve(c, v, frames, capacity); });
    work_type const work(
        [&](ft::carver& c, ft::transform_workspace& w) { carve(c, w, 2, work_capacity); });
    try {
      ft::fill(exec, in.view(), 0);
      ft::transform_to_words(exec, made.view(), in.view(), {up}, out.view(), work.view());
      exec.wait();
      return false;
    } catch (ft::bad_argument const&) { return true; }
  };
  EXPECT_FALSE(refuses(2, 5, 5, 4));
  EXPECT_TRUE(refuses(1, 5, 5, 4));
  EXPECT_TRUE(refuses(3, 5, 5, 4));
  EXPECT_TRUE(refuses(2, 4, 5, 4));
  EXPECT_TRUE(refuses(2, 5, 4, 4));
  EXPECT_TRUE(refuses(2, 5, 5, -1));
  EXPECT_TRUE(refuses(2, 5, 5, 11));
}

}  // namespace transform_words_test
