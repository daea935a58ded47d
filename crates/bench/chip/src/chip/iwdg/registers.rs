//! Registers of the independent watchdog (RM0090 section 21.4).

/// Offset of IWDG_KR, the key register (21.4.1).
pub(crate) const KR_OFFSET: u32 = 0x00;
/// Offset of IWDG_PR, the prescaler (21.4.2).
pub(crate) const PR_OFFSET: u32 = 0x04;
/// Offset of IWDG_RLR, the reload value (21.4.3).
pub(crate) const RLR_OFFSET: u32 = 0x08;
/// Offset of IWDG_SR, the status register (21.4.4).
pub(crate) const SR_OFFSET: u32 = 0x0c;

/// IWDG_KR: opens IWDG_PR and IWDG_RLR.
pub(super) const KR_UNLOCK: u32 = 0x5555;
/// IWDG_KR: starts the watchdog.
pub(super) const KR_START: u32 = 0xcccc;
/// IWDG_KR: reloads the counter.
pub(super) const KR_RELOAD: u32 = 0xaaaa;
/// IWDG_PR, PR: the implemented bits.
pub(super) const PR_MASK: u32 = 0x7;
/// IWDG_RLR, RL: the implemented bits.
pub(super) const RLR_MASK: u32 = 0xfff;
/// Value of IWDG_RLR, and of the counter, after a reset.
pub(crate) const RLR_RESET: u32 = 0xfff;
/// IWDG_SR, RVU: position of the flag of a reload value under update.
pub(crate) const SR_RVU_SHIFT: u32 = 1;
