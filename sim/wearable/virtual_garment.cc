#include "sim/wearable/virtual_garment.h"

#include <fmt/format.h>

#include <cerrno>
#include <chrono>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <system_error>
#include <thread>

namespace secondskin::sim {
namespace {

constexpr std::uint32_t kSlotsPerReport = 32;
constexpr double kPatience = 0.5;  // with a reader [s]
constexpr double kLatest = 2.0;    // behind the time [s]

std::vector<std::int16_t> room_for_slot(const wire::GarmentStreamHeader& header) {
  return std::vector<std::int16_t>(static_cast<std::size_t>(header.boards) * header.slot_samples);
}

double slot_time(const wire::GarmentStreamHeader& header) {
  return static_cast<double>(header.slot_samples) / header.sample_rate_hz;
}

}  // namespace

std::uint32_t write_garment_file(GarmentSignal& signal, std::uint32_t slots,
                                 const std::filesystem::path& file, std::stop_token stop,
                                 const SlotProgress& progress) {
  const wire::GarmentStreamHeader header = signal.header();
  std::uint32_t done = 0;
  const auto fail = [&](int error) {
    throw std::system_error(error, std::generic_category(),
                            fmt::format("{}: written in part ({:.1f} s of {:.1f} s)", file.string(),
                                        done * slot_time(header), slots * slot_time(header)));
  };
  const auto close = [](std::FILE* f) { std::fclose(f); };
  std::unique_ptr<std::FILE, decltype(close)> out(std::fopen(file.c_str(), "wb"), close);
  if (!out) fail(errno);
  auto samples = room_for_slot(header);
  std::vector<std::uint8_t> bytes;
  for (; done < slots && !stop.stop_requested(); ++done) {
    signal.next(samples);
    bytes.clear();
    wire::append_slot(header, done, samples, bytes);
    if (std::fwrite(bytes.data(), 1, bytes.size(), out.get()) != bytes.size()) fail(errno);
    if (progress && (done + 1) % kSlotsPerReport == 0) progress(done + 1);
  }
  if (std::fflush(out.get()) != 0) fail(errno);
  if (std::fclose(out.release()) != 0) fail(errno);
  if (progress) progress(done);
  return done;
}

LinkCounters serve_garment(GarmentSignal& signal, std::uint32_t slots, wire::ByteLink& link,
                           const std::function<std::uint64_t()>& poll, std::stop_token stop,
                           const SlotProgress& progress) {
  using Clock = std::chrono::steady_clock;
  const wire::GarmentStreamHeader header = signal.header();
  const double slot = slot_time(header);
  const auto start = Clock::now();
  const auto now = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
  const auto most = static_cast<std::size_t>(kPatience / slot) * header.block_size();
  auto samples = room_for_slot(header);
  std::vector<std::uint8_t> pending;
  std::size_t written = 0;  // of pending
  std::uint64_t connection = 0;
  LinkCounters counters;
  // After the last slot, what is pending still has a moment to leave.
  while (!stop.stop_requested() && (counters.slots < slots || (written < pending.size() &&
                                                               now() < slot * slots + kPatience))) {
    if (const std::uint64_t newest = poll(); newest != connection) {
      connection = newest;
      pending.clear();
      written = 0;
      if (connection != 0) wire::append_header(header, pending);
    }
    const double due = slot * (counters.slots + 1);
    if (counters.slots < slots && now() >= due) {
      if (now() > due + kLatest) {
        throw std::runtime_error(fmt::format(
            "virtual garment: this machine makes {:.0f} slots a second, {:.0f} are needed",
            counters.slots / now(), 1.0 / slot));
      }
      signal.next(samples);
      if (connection != 0 && pending.size() - written < most) {
        pending.erase(pending.begin(), pending.begin() + static_cast<std::ptrdiff_t>(written));
        written = 0;
        wire::append_slot(header, counters.slots, samples, pending);
      } else {
        ++counters.dropped;
      }
      ++counters.slots;
      if (progress && counters.slots % kSlotsPerReport == 0) progress(counters.slots);
    }
    const std::size_t count = link.write_some(std::span(pending).subspan(written));
    written += count;
    counters.bytes += count;
    if (count == 0) std::this_thread::sleep_for(std::chrono::microseconds(500));
  }
  return counters;
}

}  // namespace secondskin::sim
