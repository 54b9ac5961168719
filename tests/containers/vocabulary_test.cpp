// SPDX-License-Identifier: Apache-2.0
// Vocabularies made of arrays: the order of their nodes, what is refused, copies in executors.
#include "ft/containers/vocabulary.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <set>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"
#include "tests/support/refusals.hpp"

namespace vocabulary_test {

using test::at;
using test::generator;
using test::plain_vocabulary;

static_assert(!std::is_copy_constructible<ft::vocabulary<ft::memory_space::host>>::value,
              "move-only");

/// Every node of the arrays once, under its parent, siblings ascending and side by side.
void expect_tree(ft::vocabulary_view const& v, plain_vocabulary const& plain) {
  ASSERT_EQ(v.nodes, plain.nodes());
  std::vector<std::uint32_t> parent(at(v.nodes), ft::no_word);
  std::set<std::uint32_t> ids;
  int words = 0;
  int next = 1;
  for (int i = 0; i < v.nodes; ++i) {
    auto const& c = v.children[i];
    EXPECT_EQ(c.first, next) << "breadth first";
    next += c.count;
    for (int k = 0; k < c.count; ++k) {
      ASSERT_LT(c.first + k, v.nodes);
      parent[at(c.first + k)] = v.node[i];
      if (k > 0) { EXPECT_LT(v.node[c.first + k - 1], v.node[c.first + k]); }
    }
    auto const id = at(static_cast<int>(v.node[i]));
    ids.insert(v.node[i]);
    EXPECT_EQ(parent[at(i)], static_cast<std::uint32_t>(plain.parent[id]));
    EXPECT_EQ(v.word[i], static_cast<std::uint32_t>(plain.word[id]));
    EXPECT_EQ(v.weight[i], plain.weight[id]);
    EXPECT_EQ(ft::hamming(v.orb[i], plain.orb[id]), 0);
    words += static_cast<int>(v.word[i] != ft::no_word);
  }
  EXPECT_EQ(ids.size(), at(v.nodes));
  EXPECT_EQ(v.words, words);
}

TEST(Vocabulary, HasEveryNodeOfItsArrays) {
  generator random(1);
  for (int round = 0; round < 60; ++round) {
    SCOPED_TRACE(round);
    auto v = test::random_vocabulary(random, random.from_to(1, 5), random.from_to(1, 5),
                                     random.below(50));
    v.header.scoring = ft::word_scoring::dot_product;
    v.header.weighting = ft::word_weighting::binary;
    if (round % 2 == 1) { v = test::with_shuffled_ids(v, static_cast<unsigned>(round)); }
    auto const made = ft::make_vocabulary(v.arrays());
    expect_tree(made.view(), v);
    EXPECT_EQ(made->header.branching, v.header.branching);
    EXPECT_EQ(made->header.levels, v.header.levels);
    EXPECT_EQ(made->header.scoring, ft::word_scoring::dot_product);
    EXPECT_EQ(made->header.weighting, ft::word_weighting::binary);
  }
}

TEST(Vocabulary, OfItsRootHasNoWords) {
  plain_vocabulary const v;
  auto const made = ft::make_vocabulary(v.arrays());
  expect_tree(made.view(), v);
  EXPECT_EQ(made->words, 0);
  EXPECT_EQ(made->children[0].count, 0);
}

TEST(Vocabulary, OfOneLevelHasItsWordsBelowTheRoot) {
  auto const v = test::drawn_vocabulary(20, 1);
  auto const made = ft::make_vocabulary(v.arrays());
  expect_tree(made.view(), v);
  EXPECT_EQ(made->words, 20);
}

TEST(Vocabulary, DrawnOnesDifferFromTheirParentsByTheirDepth) {
  auto const v = test::drawn_vocabulary(10, 3);
  ASSERT_EQ(v.nodes(), 1111);
  double sum[4] = {};
  int count[4] = {};
  for (int i = 1; i < v.nodes(); ++i) {
    int const depth = i < 11 ? 1 : i < 111 ? 2 : 3;
    sum[depth] += ft::hamming(v.orb[at(i)], v.orb[at(v.parent[at(i)])]);
    ++count[depth];
  }
  EXPECT_NEAR(sum[1] / count[1], 128, 16);
  EXPECT_NEAR(sum[2] / count[2], 64, 4);
  EXPECT_NEAR(sum[3] / count[3], 32, 1);
}

std::string refusal(plain_vocabulary const& v) {
  return test::refusal([&] { ft::make_vocabulary(v.arrays()); });
}

TEST(Vocabulary, SaysWhatItRefuses) {
  auto const good = test::drawn_vocabulary(3, 2);  // 1 to 3 below the root, 4 to 12 below those
  ASSERT_EQ(refusal(good), "");
  using change = std::function<void(plain_vocabulary&)>;
  std::vector<std::pair<change, char const*>> const faults{
      {[](auto& v) { v.header.branching = 21; }, "branching of a vocabulary is 21"},
      {[](auto& v) { v.header.branching = -1; }, "branching of a vocabulary is -1"},
      {[](auto& v) { v.header.branching = 2; },
       "node 0 of the vocabulary has more than 2 children"},
      {[](auto& v) { v.header.levels = 0; }, "levels of a vocabulary is 0, must be in [1, 10]"},
      {[](auto& v) { v.header.levels = 11; }, "levels of a vocabulary is 11"},
      {[](auto& v) { v.header.levels = 1; }, "node 4 of the vocabulary lies 2 below the root"},
      {[](auto& v) { v.header.scoring = static_cast<ft::word_scoring>(6); }, "scoring"},
      {[](auto& v) { v.header.weighting = static_cast<ft::word_weighting>(-1); }, "weighting"},
      {[](auto& v) { v.parent[0] = 0; }, "node 0 of the vocabulary has parent 0, the root's"},
      {[](auto& v) { v.parent[5] = -1; }, "node 5 of the vocabulary has parent -1, must be in [0"},
      {[](auto& v) { v.parent[5] = 13; }, "node 5 of the vocabulary has parent 13"},
      {[](auto& v) { v.parent[1] = 4; }, "node 1 of the vocabulary is not below the root"},
      {[](auto& v) { v.parent[2] = 2; }, "node 2 of the vocabulary has more than 3 children"},
      {[](auto& v) { v.word[5] = -1; }, "node 5 of the vocabulary has word -1, must be in [0, 8]"},
      {[](auto& v) { v.word[5] = 9; }, "node 5 of the vocabulary has word 9, must be in [0, 8]"},
      {[](auto& v) { v.word[5] = 0; }, "node 5 of the vocabulary has word 0, as another node has"},
      {[](auto& v) { v.word[1] = 3; }, "node 1 of the vocabulary has word 3, but is the root or"},
      {[](auto& v) { v.word[0] = 0; }, "node 0 of the vocabulary has word 0, but is the root or"},
      {[](auto& v) { v.weight[7] = std::numeric_limits<double>::quiet_NaN(); },
       "node 7 of the vocabulary has weight nan, must be finite"},
      {[](auto& v) { v.weight[8] = std::numeric_limits<double>::infinity(); }, "has weight inf"},
      {[](auto& v) { v.orb.pop_back(); }, "different lengths"},
      {[](auto& v) { v.weight.pop_back(); }, "different lengths"},
      {[](auto& v) { v.word.push_back(1); }, "different lengths"},
      {[](auto& v) { v.parent.clear(); }, "1 node or more"},
  };
  for (auto const& [spoil, message] : faults) {
    auto v = good;
    spoil(v);
    EXPECT_NE(refusal(v).find(message), std::string::npos) << message << "; said: " << refusal(v);
  }
}

template <typename Backend>
class VocabularyOwner : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(VocabularyOwner, test::backends);

TYPED_TEST(VocabularyOwner, IsCopiedWhole) {
  TypeParam backend;
  auto const& exec = backend.exec;
  generator random(3);
  auto const plain = test::random_vocabulary(random, 5, 4, 20);
  auto const host = ft::make_vocabulary(plain.arrays());
  auto made = ft::upload(exec, host.view());
  auto const owned = std::move(made);
  EXPECT_EQ(made->nodes, 0);
  auto const n = at(owned->nodes);
  auto children = test::from_exec(exec, owned->children, n);
  auto orb = test::from_exec(exec, owned->orb, n);
  auto weight = test::from_exec(exec, owned->weight, n);
  auto word = test::from_exec(exec, owned->word, n);
  auto node = test::from_exec(exec, owned->node, n);
  ft::vocabulary_view const back{owned->header, owned->nodes,  owned->words, children.data(),
                                 orb.data(),    weight.data(), word.data(),  node.data()};
  expect_tree(back, plain);
  EXPECT_EQ(back.header.levels, plain.header.levels);
  EXPECT_THROW(ft::upload(exec, ft::vocabulary_view{}), ft::bad_argument);
}

}  // namespace vocabulary_test
