"""The proof: concealed cases of three realities, real machines and implants, judged and counted."""
