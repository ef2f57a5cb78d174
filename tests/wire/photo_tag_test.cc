#include "wire/photo_tag.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <optional>
#include <random>
#include <utility>
#include <vector>

namespace secondskin::wire {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Random = std::mt19937_64;

std::size_t draw(Random& random, std::size_t below) {
  return std::uniform_int_distribution<std::size_t>(0, below - 1)(random);
}

Bytes draw_values(Random& random, const TagFormat& format) {
  Bytes values(format.values());
  for (std::uint8_t& value : values) value = static_cast<std::uint8_t>(draw(random, 255));
  return values;
}

/// What a decoder gave out.
struct Decoded {
  std::vector<TagSet> sets;
  TagDecoder::Sink sink = [this](const TagSet& set) { sets.push_back(set); };
  std::vector<Bytes> values() const {
    std::vector<Bytes> all;
    for (const TagSet& set : sets) all.push_back(set.values);
    return all;
  }
};

std::vector<Bytes> decode(const TagFormat& format, const Bytes& stream) {
  TagDecoder decoder(format);
  Decoded out;
  decoder.feed(stream, 0, out.sink);
  decoder.finish(out.sink);
  return out.values();
}

/// The rule written the other way round: what lies between two starts, or a start and the end of
/// the stream, is a set if it has its length.
std::vector<Bytes> split(const TagFormat& format, const Bytes& stream) {
  std::vector<Bytes> sets;
  std::optional<Bytes> run;
  const auto close = [&] {
    if (run && run->size() == format.values()) sets.push_back(*run);
  };
  for (const std::uint8_t byte : stream) {
    if (byte == kSetStart) {
      close();
      run.emplace();
    } else if (run) {
      run->push_back(byte);
    }
  }
  close();
  return sets;
}

TEST(ProjectorTiming, IsThePapers) {
  // 2.1.2: eight frames in 528 us, with the sync bit 661 us; a slot of 1000 us; fifteen pulses.
  EXPECT_EQ(kBits * (kBitOnNs + kBitOffNs), 528'000);
  EXPECT_EQ(bit_start_ns(0, kBits - 1) + kBitOnNs + kBitOffNs, 661'000);
  EXPECT_EQ(bit_start_ns(1, 0), 1'000'000);
  EXPECT_NEAR(kCarrierHz * 1e-9 * kBitOnNs, 15.0, 0.02);
  // 2.3: sixteen projectors make 62.5 Hz.
  EXPECT_EQ(1'000'000'000.0 / cycle_ns(16), 62.5);
  // The instant of a value is the middle of its eight bits.
  for (const std::size_t projector : std::initializer_list<std::size_t>{0, 1, 15}) {
    std::int64_t sum = 0;
    for (int bit = 0; bit < kBits; ++bit) sum += bit_start_ns(projector, bit) + kBitOnNs / 2;
    EXPECT_EQ(value_time_ns(projector), sum / kBits);
  }
}

TEST(GrayCode, IsTheMasksOfFigure2_2) {
  const Bytes three_bits{0b000, 0b001, 0b011, 0b010, 0b110, 0b111, 0b101, 0b100};
  for (std::uint8_t i = 0; i < 8; ++i) EXPECT_EQ(to_gray(i), three_bits[i]);
}

TEST(GrayCode, ComesBackAndChangesOneBitAStep) {
  for (int i = 0; i < 256; ++i) {
    const auto value = static_cast<std::uint8_t>(i);
    EXPECT_EQ(from_gray(to_gray(value)), value);
    const unsigned changed = to_gray(value) ^ to_gray(static_cast<std::uint8_t>(i + 1));
    EXPECT_EQ(__builtin_popcount(changed), 1) << i;
  }
}

TEST(EncodeSet, IsTheStartByteThenDetectorsThenProjectors) {
  Bytes bytes{7};
  encode_set({2, 3, false}, Bytes{1, 2, 3, 0, 254, 255}, bytes);
  EXPECT_EQ(bytes, (Bytes{7, 0xFF, 1, 2, 3, 0, 254, 254}));
}

TEST(EncodeSet, RefusesAnotherNumberOfValues) {
  Bytes bytes;
  EXPECT_THROW(encode_set({2, 3, false}, Bytes(5), bytes), std::invalid_argument);
}

TEST(EncodeSet, NeverHasAStartByteInGrayCode) {
  for (int i = 0; i < 256; ++i) {
    Bytes bytes;
    encode_set({1, 1, true}, Bytes{static_cast<std::uint8_t>(i)}, bytes);
    ASSERT_NE(bytes[1], kSetStart) << i;
    const Bytes back = decode({1, 1, true}, bytes).at(0);
    // 170 is the one whose code is the start byte; it comes one count away.
    EXPECT_EQ(back[0], i == 170 ? 171 : std::min(i, 254)) << i;
  }
}

TEST(TagDecoder, RefusesAFormatThatNoTagHas) {
  EXPECT_THROW(TagDecoder({0, 16, false}), std::invalid_argument);
  EXPECT_THROW(TagDecoder({19, 16, false}), std::invalid_argument);
  EXPECT_THROW(TagDecoder({18, 0, false}), std::invalid_argument);
  EXPECT_THROW(TagDecoder({18, 256, false}), std::invalid_argument);
}

TEST(TagDecoder, GivesBackWhatWasSentForAnyFormat) {
  Random random(1);
  for (int i = 0; i < 300; ++i) {
    const TagFormat format{1 + draw(random, kDetectorsOnATag), 1 + draw(random, 20), false};
    std::vector<Bytes> sent;
    Bytes stream;
    for (int k = 0; k < 5; ++k) {
      sent.push_back(draw_values(random, format));
      encode_set(format, sent.back(), stream);
    }
    EXPECT_EQ(decode(format, stream), sent);
  }
}

TEST(TagDecoder, TakesGray255ForNoValue) {
  EXPECT_EQ(decode({1, 2, true}, {0xFF, 128, 129}), (std::vector<Bytes>{{kNoValue, 254}}));
}

class SmallDecoder : public testing::Test {
 protected:
  static constexpr std::int64_t kMs = 1'000'000;
  void feed(const Bytes& bytes, std::int64_t now_ns = 0) {
    decoder_.feed(bytes, now_ns, out_.sink);
  }

  TagDecoder decoder_{{1, 3, false}};
  Decoded out_;
};

TEST_F(SmallDecoder, WaitsForTheNextStart) {
  feed({0xFF, 1, 2, 3}, 5);
  EXPECT_TRUE(out_.sets.empty());
  feed({0xFF}, 20);
  ASSERT_EQ(out_.sets.size(), 1U);
  EXPECT_EQ(out_.sets[0].values, (Bytes{1, 2, 3}));
  EXPECT_EQ(out_.sets[0].arrival_ns, 5);
  EXPECT_EQ(out_.sets[0].number, 0U);
}

TEST_F(SmallDecoder, OrForSilence) {
  feed({0xFF, 1, 2}, 0);
  feed({3}, 1 * kMs);
  decoder_.tick(1 * kMs + TagDecoder::kSilenceNs - 1, out_.sink);
  EXPECT_TRUE(out_.sets.empty());
  decoder_.tick(1 * kMs + TagDecoder::kSilenceNs, out_.sink);
  decoder_.tick(100 * kMs, out_.sink);
  EXPECT_EQ(out_.values(), (std::vector<Bytes>{{1, 2, 3}}));
  feed({0xFF, 4, 5, 6, 0xFF}, 101 * kMs);
  EXPECT_EQ(out_.values(), (std::vector<Bytes>{{1, 2, 3}, {4, 5, 6}}));
  EXPECT_EQ(decoder_.counters().torn, 0U);
}

TEST_F(SmallDecoder, SilenceInsideASetDoesNotEndIt) {
  feed({0xFF, 1, 2});
  decoder_.tick(100 * kMs, out_.sink);
  feed({3, 0xFF}, 100 * kMs);
  EXPECT_EQ(out_.values(), (std::vector<Bytes>{{1, 2, 3}}));
}

TEST_F(SmallDecoder, DropsShortAndLongSetsWholeAndNumbersThem) {
  feed({0xFF, 1, 2, 0xFF, 1, 2, 3, 4, 0xFF, 5, 6, 7, 0xFF});
  ASSERT_EQ(out_.values(), (std::vector<Bytes>{{5, 6, 7}}));
  // Two bytes, then five: at least one set and at least two.
  EXPECT_EQ(out_.sets[0].number, 3U);
  EXPECT_EQ(decoder_.counters().torn, 3U);
  EXPECT_EQ(decoder_.counters().stray_bytes, 3U + 5U);
}

TEST_F(SmallDecoder, TwoSetsWithoutTheStartBetweenAreTwoCycles) {
  feed({0xFF, 1, 2, 3, 1, 2, 3, 0xFF, 5, 6, 7, 0xFF});
  ASSERT_EQ(out_.sets.size(), 1U);
  EXPECT_EQ(out_.sets[0].number, 2U);
}

TEST_F(SmallDecoder, BytesBeforeTheFirstStartAreNoSet) {
  feed({1, 2, 3, 4, 5, 6, 7, 0xFF, 5, 6, 7, 0xFF});
  ASSERT_EQ(out_.sets.size(), 1U);
  EXPECT_EQ(out_.sets[0].number, 0U);
  EXPECT_EQ(decoder_.counters().torn, 0U);
  EXPECT_EQ(decoder_.counters().stray_bytes, 7U);
}

TEST_F(SmallDecoder, CountsGarbageAsItComes) {
  feed({0xFF, 1, 2, 3});
  decoder_.tick(kMs * 10, out_.sink);
  feed(Bytes(1000, 9), kMs * 10);
  EXPECT_EQ(decoder_.counters().stray_bytes, 1000U);
  EXPECT_EQ(decoder_.counters().bytes, 1004U);
}

TEST_F(SmallDecoder, TheEndOfAFileEndsItsLastSet) {
  feed({0xFF, 1, 2, 3, 0xFF, 4, 5});
  decoder_.finish(out_.sink);
  EXPECT_EQ(out_.values(), (std::vector<Bytes>{{1, 2, 3}}));
  EXPECT_EQ(decoder_.counters().torn, 1U);
}

TEST(TagDecoder, AgreesWithSplittingAtTheStartsForAnyBytes) {
  Random random(2);
  for (int i = 0; i < 2000; ++i) {
    const TagFormat format{1 + draw(random, 3), 1 + draw(random, 3), false};
    Bytes stream(draw(random, 200));
    // Many starts, so that every length of a run occurs.
    for (std::uint8_t& byte : stream) {
      byte = draw(random, 5) == 0 ? kSetStart : static_cast<std::uint8_t>(draw(random, 255));
    }
    ASSERT_EQ(decode(format, stream), split(format, stream));
  }
}

TEST(TagDecoder, DoesNotDependOnHowTheBytesAreCut) {
  Random random(3);
  for (int i = 0; i < 500; ++i) {
    const TagFormat format{1 + draw(random, 3), 1 + draw(random, 4), draw(random, 2) == 1};
    Bytes stream(1 + draw(random, 300));
    for (std::uint8_t& byte : stream) {
      byte = draw(random, 6) == 0 ? kSetStart : static_cast<std::uint8_t>(draw(random, 255));
    }
    // Some places where the line is silent; between them all bytes come at one time.
    std::vector<std::size_t> silences{0, stream.size()};
    for (std::size_t k = draw(random, 6); k > 0; --k)
      silences.push_back(draw(random, stream.size()));
    std::sort(silences.begin(), silences.end());

    const auto run = [&](bool whole) {
      TagDecoder decoder(format);
      Decoded out;
      for (std::size_t s = 1; s < silences.size(); ++s) {
        const auto now_ns = static_cast<std::int64_t>(s) * TagDecoder::kSilenceNs;
        std::size_t at = silences[s - 1];
        while (at < silences[s]) {
          const std::size_t rest = silences[s] - at;
          const std::size_t count = whole ? rest : std::min(rest, 1 + draw(random, 7));
          decoder.feed(std::span(stream).subspan(at, count), now_ns, out.sink);
          at += count;
        }
        decoder.tick(now_ns + TagDecoder::kSilenceNs, out.sink);
      }
      decoder.finish(out.sink);
      return std::pair(std::move(out.sets), decoder.counters());
    };
    const auto [whole, whole_counters] = run(true);
    const auto [cut, cut_counters] = run(false);
    ASSERT_EQ(whole.size(), cut.size());
    for (std::size_t k = 0; k < whole.size(); ++k) {
      ASSERT_EQ(whole[k].values, cut[k].values);
      ASSERT_EQ(whole[k].number, cut[k].number);
      ASSERT_EQ(whole[k].arrival_ns, cut[k].arrival_ns);
    }
    EXPECT_EQ(whole_counters.torn, cut_counters.torn);
    EXPECT_EQ(whole_counters.stray_bytes, cut_counters.stray_bytes);
  }
}

/// A stream through a bad line, with what became of each set.
struct BadLine {
  TagFormat format;
  std::vector<Bytes> sent;
  Bytes stream;
  std::vector<bool> intact;   ///< all its bytes came, with nothing between
  std::vector<bool> started;  ///< its start byte came, with nothing before it in its place

  /// @param damage  changes a set's bytes; true if it did
  template <class Damage>
  BadLine(const TagFormat& f, std::size_t sets, Random& random, Damage damage) : format(f) {
    for (std::size_t k = 0; k < sets; ++k) {
      sent.push_back(draw_values(random, format));
      Bytes bytes;
      encode_set(format, sent.back(), bytes);
      intact.push_back(!damage(bytes));
      started.push_back(!bytes.empty() && bytes[0] == kSetStart);
      stream.insert(stream.end(), bytes.begin(), bytes.end());
    }
  }

  /// Sent sets that must come: intact, and what follows says so.
  std::vector<Bytes> certain() const {
    std::vector<Bytes> sets;
    for (std::size_t k = 0; k < sent.size(); ++k) {
      const bool confirmed = k + 1 == sent.size() || started[k + 1];
      if (intact[k] && confirmed) sets.push_back(sent[k]);
    }
    return sets;
  }
};

bool is_subsequence(const std::vector<Bytes>& part, const std::vector<Bytes>& whole) {
  auto at = whole.begin();
  for (const Bytes& set : part) {
    at = std::find(at, whole.end(), set);
    if (at == whole.end()) return false;
    ++at;
  }
  return true;
}

template <class Damage>
void expect_only_sent_sets(Random& random, Damage damage) {
  for (int i = 0; i < 60; ++i) {
    const TagFormat format{6 + draw(random, 13), 16, false};
    const BadLine line(format, 60, random, damage);
    TagDecoder decoder(format);
    Decoded out;
    std::size_t at = 0;
    while (at < line.stream.size()) {
      const std::size_t count = std::min(line.stream.size() - at, 1 + draw(random, 700));
      decoder.feed(std::span(line.stream).subspan(at, count), 0, out.sink);
      at += count;
    }
    decoder.finish(out.sink);
    ASSERT_TRUE(is_subsequence(out.values(), line.sent));
    ASSERT_TRUE(is_subsequence(line.certain(), out.values()));
    const TagCounters& counters = decoder.counters();
    EXPECT_EQ(counters.bytes, line.stream.size());
    EXPECT_EQ(counters.sets, out.sets.size());
    EXPECT_EQ(counters.bytes, counters.sets * (1 + format.values()) + counters.stray_bytes);
    for (std::size_t k = 1; k < out.sets.size(); ++k) {
      ASSERT_GT(out.sets[k].number, out.sets[k - 1].number);
    }
    // Inserted bytes can pass for one more set.
    ASSERT_FALSE(out.sets.empty());
    if (line.stream.size() <= line.sent.size() * (1 + format.values())) {
      EXPECT_LT(out.sets.back().number, line.sent.size());
    }
  }
}

TEST(TagDecoder, GivesOutOnlySentSetsWhereBytesAreLost) {
  Random random(4);
  for (const double loss : {0.0, 0.0001, 0.001, 0.01}) {
    std::bernoulli_distribution lost(loss);
    expect_only_sent_sets(random, [&](Bytes& bytes) {
      return std::erase_if(bytes, [&](std::uint8_t) { return lost(random); }) > 0;
    });
  }
}

TEST(TagDecoder, GivesOutOnlySentSetsWhereRunsAreLost) {
  Random random(5);
  std::bernoulli_distribution torn(0.2);
  expect_only_sent_sets(random, [&](Bytes& bytes) {
    if (!torn(random)) return false;
    const std::size_t begin = draw(random, bytes.size());
    const std::size_t end = begin + 1 + draw(random, bytes.size() - begin);
    bytes.erase(bytes.begin() + static_cast<std::ptrdiff_t>(begin),
                bytes.begin() + static_cast<std::ptrdiff_t>(end));
    return true;
  });
}

TEST(TagDecoder, GivesOutOnlySentSetsWhereBytesAreInserted) {
  Random random(6);
  std::bernoulli_distribution hit(0.2);
  expect_only_sent_sets(random, [&](Bytes& bytes) {
    if (!hit(random)) return false;
    const std::size_t at = 1 + draw(random, bytes.size() - 1);
    bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(at), 1 + draw(random, 4),
                 static_cast<std::uint8_t>(draw(random, 255)));
    return true;
  });
}

TEST(TagDecoder, GivesOutOnlySentSetsWhereALossReachesOverBoundaries) {
  Random random(7);
  const TagFormat format{18, 16, false};
  const std::size_t length = 1 + format.values();
  for (int i = 0; i < 3000; ++i) {
    BadLine line(format, 5, random, [](Bytes&) { return false; });
    const std::size_t begin = draw(random, 2 * length);
    const std::size_t count = 1 + draw(random, 2 * length);
    line.stream.erase(line.stream.begin() + static_cast<std::ptrdiff_t>(begin),
                      line.stream.begin() + static_cast<std::ptrdiff_t>(begin + count));
    const std::vector<Bytes> sets = decode(format, line.stream);
    const bool whole_lengths_from_inside = count % length == 0 && begin % length != 0;
    if (whole_lengths_from_inside) continue;  // the one loss that the format cannot show
    ASSERT_TRUE(is_subsequence(sets, line.sent)) << begin << " " << count;
    ASSERT_EQ(sets.back(), line.sent.back());
  }
}

TEST(TagDecoder, AFlippedBitNeverShiftsAValue) {
  Random random(8);
  const TagFormat format{18, 16, false};
  std::bernoulli_distribution flip(0.0005);
  std::size_t given = 0;
  for (int i = 0; i < 100; ++i) {
    std::size_t flips = 0;
    const BadLine line(format, 50, random, [&](Bytes& bytes) {
      bool changed = false;
      for (std::uint8_t& byte : bytes) {
        if (!flip(random)) continue;
        byte = static_cast<std::uint8_t>(byte ^ (1U << draw(random, 8)));
        ++flips;
        changed = true;
      }
      return changed;
    });
    std::size_t different = 0;
    auto at = line.sent.begin();
    const std::vector<Bytes> sets = decode(format, line.stream);
    for (const Bytes& set : sets) {
      // The sent set that it is but for its flipped values.
      const auto distance = [&](const Bytes& sent) {
        std::size_t sum = 0;
        for (std::size_t k = 0; k < sent.size(); ++k) sum += sent[k] != set[k];
        return sum;
      };
      at = std::find_if(at, line.sent.end(), [&](const Bytes& sent) { return distance(sent) < 5; });
      ASSERT_NE(at, line.sent.end());
      different += distance(*at);
      ++at;
    }
    EXPECT_LE(different, flips);
    ASSERT_TRUE(is_subsequence(line.certain(), sets));
    given += sets.size();
  }
  EXPECT_GT(given, 4500U);
}

TEST(TagDecoder, MissesAtMostOneSetAfterAnyDamage) {
  Random random(9);
  const TagFormat format{2, 3, false};
  for (int i = 0; i < 2000; ++i) {
    Bytes stream(draw(random, 40));
    for (std::uint8_t& byte : stream) byte = static_cast<std::uint8_t>(draw(random, 256));
    std::vector<Bytes> sent;
    for (int k = 0; k < 4; ++k) {
      sent.push_back(draw_values(random, format));
      encode_set(format, sent.back(), stream);
    }
    std::vector<Bytes> sets = decode(format, stream);
    ASSERT_GE(sets.size(), 4U);  // even the first: its start byte ends whatever was before
    sets.erase(sets.begin(), sets.end() - 4);
    EXPECT_EQ(sets, sent);
  }
}

}  // namespace
}  // namespace secondskin::wire
