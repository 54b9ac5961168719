// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <vector>

int first_count(unsigned char const* pixels, int width, int height);
int second_count(unsigned char const* pixels, int width, int height);

int main() {
  constexpr int width = 320, height = 240;
  std::vector<unsigned char> pixels;
  for (int i = 0; i < width * height; ++i) {
    pixels.push_back(
        static_cast<unsigned char>((i % width / 9 * 7919 ^ i / width / 9 * 104729) % 251));
  }
  int const first = first_count(pixels.data(), width, height);
  int const second = second_count(pixels.data(), width, height);
  std::printf("%d and %d keypoints\n", first, second);
  return first == second && first > 100 ? 0 : 1;
}
