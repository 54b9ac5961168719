// SPDX-License-Identifier: Apache-2.0
#include "bench/words_scene.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <map>
#include <numeric>
#include <utility>

#include "ft/core/counter_draws.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"

namespace bench {

namespace {

using test::at;
using test::generator;

bits_256 bits_of(ft::descriptor const& d) {
  bits_256 b;
  std::memcpy(b.words, d.words, sizeof b.words);
  return b;
}
bits_256 random_bits(generator& random) { return bits_of(random.descriptor()); }
/// With up to `bits` bits changed.
bits_256 flipped(generator& random, bits_256 const& from, int bits) {
  ft::descriptor d;
  std::memcpy(d.words, from.words, sizeof d.words);
  return bits_of(random.flipped(d, bits));
}
bits_256 near_word(generator& random, drawn_tree const& tree) {
  int const leaves = static_cast<int>(tree.word.size()) / drawn_tree::branching * 9;
  int const leaf = static_cast<int>(tree.word.size()) - 1 - random.below(leaves);
  return flipped(random, tree.orb[at(leaf)], 20);
}

template <typename T>
void shuffle(generator& random, std::vector<T>& list) {
  for (int i = static_cast<int>(list.size()) - 1; i > 0; --i) {
    std::swap(list[at(i)], list[at(random.below(i + 1))]);
  }
}

/// An octave, as often as its image has pixels in one direction.
int draw_octave(generator& random) {
  float rest = random.real(0, 1) *
               (1 - 1 / std::pow(drawn_camera::scale, static_cast<float>(drawn_camera::levels))) /
               (1 - 1 / drawn_camera::scale);
  float share = 1;
  int octave = 0;
  for (; octave + 1 < drawn_camera::levels && rest >= share; ++octave) {
    rest -= share;
    share /= drawn_camera::scale;
  }
  return octave;
}
/// Noise of a keypoint's position, pixels of the input image.
float noise(generator& random, int octave) {
  return random.real(-0.6f, 0.6f) * std::pow(drawn_camera::scale, static_cast<float>(octave));
}

void add(drawn_image& to, float x, float y, float angle, int octave, bits_256 const& orb) {
  to.x.push_back(x);
  to.y.push_back(y);
  to.angle.push_back(angle - 360 * std::floor(angle / 360));
  to.octave.push_back(octave);
  to.orb.push_back(orb);
}

/// The word at a place of the way, or any other by another seed.
std::uint32_t word_at(std::uint64_t seed, std::uint64_t place, int words) {
  return static_cast<std::uint32_t>(ft::counter_draws{seed}.below(words, place, 0));
}

constexpr int way_words = 1000;  ///< of a keyframe
constexpr int way_step = 300;    ///< words from a keyframe to the next

drawn_bag draw_bag(int words, int first, int changed_percent, unsigned seed) {
  generator random(seed);
  std::vector<std::uint32_t> all;
  for (int i = 0; i < way_words; ++i) {
    auto const place = static_cast<std::uint64_t>(first) + static_cast<std::uint64_t>(i);
    bool const other = random.chance(changed_percent);
    all.push_back(other ? static_cast<std::uint32_t>(random.below(words))
                        : word_at(7, place, words));
  }
  for (int i = 0; i < 150; ++i) {  // the lower, the more frequent
    float const u = random.real(0, 1);
    all.push_back(static_cast<std::uint32_t>(u * u * u * u * static_cast<float>(words - 1)));
  }
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  drawn_bag bag{all, {}};
  double sum = 0;
  for (std::uint32_t const word : all) {
    // A word has one rarity wherever it is.
    bag.value.push_back(1 + static_cast<double>(word_at(8, word, 1024)) / 128);
    sum += bag.value.back();
  }
  for (double& v : bag.value) { v /= sum; }
  return bag;
}

struct place_drawer {
  generator random;
  drawn_tree const& tree;
  drawn_place place;

  /// The frame, and the points that it sees: point i at keypoint i.
  void see_points() {
    float const s = std::sin(0.2f);
    float const c = std::cos(0.2f);
    for (int i = 0; i < drawn_place::features; ++i) {
      float const u = random.real(16, drawn_camera::width - 16);
      float const v = random.real(16, drawn_camera::height - 16);
      float const z = random.real(3, 12);
      float const x = (u - drawn_camera::cx) / drawn_camera::focal * z;
      float const y = (v - drawn_camera::cy) / drawn_camera::focal * z;
      int const octave = draw_octave(random);
      float const largest = std::sqrt(x * x + y * y + z * z) *
                            std::pow(drawn_camera::scale, static_cast<float>(octave) - 0.5f);
      add(place.frame, u + noise(random, octave), v + noise(random, octave), random.real(0, 360),
          octave, near_word(random, tree));
      // Turned about the y axis, and moved: T_wc.
      place.points.push_back({c * x + s * z + 0.3f, y - 0.2f, c * z - s * x + 0.5f,
                              largest / std::pow(drawn_camera::scale, 7.0f), largest,
                              flipped(random, place.frame.orb.back(), 30)});
    }
  }

  /// A keyframe, of which `seen` points are the frame's, and `alike` ones are elsewhere but look
  /// like the frame's.
  void add_keyframe(int seen, int alike) {
    drawn_image image;
    std::vector<int> holder(drawn_place::features, -1);
    std::vector<int> frame_keypoint(drawn_place::features);
    std::iota(frame_keypoint.begin(), frame_keypoint.end(), 0);
    shuffle(random, frame_keypoint);
    float const turned = random.real(-20, 20);
    for (int i = 0; i < drawn_place::features; ++i) {
      int const k = frame_keypoint[at(i)];
      int const octave = place.frame.octave[at(k)];
      if (i >= seen + alike) {
        add(image, 0, 0, random.real(0, 360), octave, near_word(random, tree));
      } else {
        // Upright cameras turn all alike.
        add(image, 0, 0, place.frame.angle[at(k)] + turned + random.real(-5, 5), octave,
            flipped(random, place.frame.orb[at(k)], random.below(i < seen ? 110 : 40)));
      }
      if (i < drawn_place::held) { holder[at(i)] = i < seen ? k : add_point(image.orb.back()); }
    }
    place.keyframes.push_back(std::move(image));
    place.holder.push_back(std::move(holder));
  }

  int add_point(bits_256 const& orb) {
    place.points.push_back(
        {random.real(-6, 6), random.real(-4, 4), random.real(3, 12), 1, 30, orb});
    return static_cast<int>(place.points.size()) - 1;
  }
};

}  // namespace

drawn_tree const& drawn_tree::of(int levels) {
  static std::map<int, drawn_tree> made;
  drawn_tree& tree = made[levels];
  if (tree.levels == 0) {
    auto const plain = test::drawn_vocabulary(branching, levels);
    tree = {levels, plain.parent, plain.word, plain.weight, {}};
    tree.orb.reserve(plain.orb.size());
    for (auto const& d : plain.orb) { tree.orb.push_back(bits_of(d)); }
  }
  return tree;
}

std::vector<bits_256> draw_descriptors(drawn_tree const& tree, int count, unsigned seed) {
  generator random(seed);
  std::vector<bits_256> drawn;
  for (int i = 0; i < count; ++i) { drawn.push_back(near_word(random, tree)); }
  return drawn;
}

drawn_bag draw_keyframe_bag(int words, int number) {
  return draw_bag(words, number * way_step, 0, static_cast<unsigned>(number));
}
drawn_bag draw_query_bag(int words, int number, unsigned seed) {
  return draw_bag(words, number * way_step + way_step / 3, 20, 1u << 20 | seed);
}

drawn_place draw_place(drawn_tree const& tree, int keyframes, int seen, unsigned seed) {
  place_drawer drawer{generator(seed), tree, {}};
  drawer.see_points();
  for (int k = 0; k + 1 < keyframes; ++k) { drawer.add_keyframe(0, 45); }
  drawer.add_keyframe(seen, 4);
  return std::move(drawer.place);
}

drawn_pair draw_pair(unsigned seed) {
  generator random(seed);
  drawn_pair pair;
  drawn_image second;
  for (int i = 0; i < drawn_pair::features; ++i) {
    float const u = random.real(16, drawn_camera::width - 16);
    float const v = random.real(16, drawn_camera::height - 16);
    float const z = random.real(4, 9);
    float const x = (u - drawn_camera::cx) / drawn_camera::focal * z;
    float const y = (v - drawn_camera::cy) / drawn_camera::focal * z;
    int const octave = draw_octave(random);
    // Every tenth looks like one before it.
    bits_256 const orb = i > 0 && random.chance(10)
                             ? flipped(random, pair.first.orb[at(random.below(i))], 40)
                             : random_bits(random);
    float const angle = random.real(0, 360);
    add(pair.first, u + noise(random, octave), v + noise(random, octave), angle, octave, orb);
    // Turned by 0.02 about the y axis, to the first order; moved by 0.3 m.
    float const moved_x = x + 0.02f * z - 0.3f;
    float const moved_z = z - 0.02f * x - 0.04f;
    float const u2 = drawn_camera::focal * moved_x / moved_z + drawn_camera::cx;
    float const v2 = drawn_camera::focal * (y + 0.03f) / moved_z + drawn_camera::cy;
    bool const inside =
        u2 > 16 && u2 < drawn_camera::width - 16 && v2 > 16 && v2 < drawn_camera::height - 16;
    if (inside && random.chance(50)) {
      add(second, u2 + noise(random, octave), v2 + noise(random, octave),
          angle + random.real(-6, 6), octave, flipped(random, orb, random.below(50)));
    } else {
      add(second, random.real(16, drawn_camera::width - 16),
          random.real(16, drawn_camera::height - 16), random.real(0, 360), octave,
          random_bits(random));
    }
  }
  std::vector<int> order(drawn_pair::features);
  std::iota(order.begin(), order.end(), 0);
  shuffle(random, order);
  for (int const i : order) {
    add(pair.second, second.x[at(i)], second.y[at(i)], second.angle[at(i)], second.octave[at(i)],
        second.orb[at(i)]);
  }
  return pair;
}

}  // namespace bench
