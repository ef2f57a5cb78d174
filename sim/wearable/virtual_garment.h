#pragma once

#include <filesystem>
#include <functional>
#include <stop_token>

#include "sim/wearable/garment_signal.h"
#include "wire/byte_link.h"

/// The driver box of a virtual garment: its signals as the bytes of wire/garment_stream.h, into a
/// file as fast as it goes, or over a link in real time.
namespace secondskin::sim {

/// Called now and then with how many slots are done.
using SlotProgress = std::function<void(std::uint32_t slots)>;

/// Writes slots from the signal's next one on.
/// @param file  replaced; what was written stays when it fails or is stopped, and can be read
/// @returns how many slots are in it, fewer than asked for only when stopped
/// @throws std::system_error naming the file and how much of it is there
std::uint32_t write_garment_file(GarmentSignal& signal, std::uint32_t slots,
                                 const std::filesystem::path& file, std::stop_token stop = {},
                                 const SlotProgress& progress = {});

struct LinkCounters {
  std::uint32_t slots = 0;    ///< made
  std::uint32_t dropped = 0;  ///< of them, not sent: nobody read them in time
  std::uint64_t bytes = 0;    ///< written
};

/// Sends each slot when its time is over. What a reader does not take within half a second is
/// dropped, whole slots at a time; who joins begins with a header.
/// @param poll      called often; returns how many connections there have been (0: nobody is there)
/// @throws std::runtime_error when this machine is too slow to make the signals in time
LinkCounters serve_garment(GarmentSignal& signal, std::uint32_t slots, wire::ByteLink& link,
                           const std::function<std::uint64_t()>& poll, std::stop_token stop,
                           const SlotProgress& progress = {});

}  // namespace secondskin::sim
